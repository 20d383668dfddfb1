"""The nonlinear reference: the same transcription as a smooth program, for IPOPT and FATROP.

Locally optimal plans without any proof. Needs CasADi (the ``bench`` extra).
"""
