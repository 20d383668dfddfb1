"""References to compare with: nonlinear programs, global solvers, dynamic programming, drivers.

The same transcription for IPOPT, FATROP and BONMIN (CasADi) and for SCIP (pyscipopt), of the
``bench`` extra; dynamic programming and drivers with rules need numpy alone.
"""
