"""The experiments of Hamednia et al. (2022), repeated with certified gaps: see ``docs/paper.md``.

    python -m benchmarks.paper              all experiments, tables and figures
    python -m benchmarks.paper.calibrate    how the car was fitted to the paper's tables

``published`` holds what the paper states, ``trips`` our trips. ``values``, ``fit`` and
``calibrate`` make the car. ``run`` sweeps over ``fronts``, ``cases`` and ``sweep`` and keeps
their rows in ``benchmarks/results``; ``tables``, ``claims``, ``page`` and ``figures`` turn them
into ``docs``.
"""
