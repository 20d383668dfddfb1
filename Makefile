# Each target does its own set-up: only Python 3.11 or later, pip and make are needed.
PYTHON ?= python3
VENV ?= .venv
BIN := $(VENV)/bin
TRIP ?= paper-400km

.PHONY: plan test test-long lint types bench bench-smoke clean

plan: $(VENV)/.run  ## plan the example trip
	$(BIN)/evrelax plan $(TRIP)

test: $(VENV)/.dev  ## the fast tests
	$(BIN)/python -m pytest -m "not long"

test-long: $(VENV)/.dev  ## the suites that take minutes
	$(BIN)/python -m pytest -m long

lint: $(VENV)/.dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: $(VENV)/.dev
	$(BIN)/mypy

bench: $(VENV)/.dev  ## compare with all peers; takes hours, resumes where it was stopped
	$(BIN)/python -m benchmarks.compare
	$(BIN)/python -m benchmarks.scale
	$(BIN)/python -m benchmarks.floor
	$(BIN)/python -m benchmarks.judges
	$(BIN)/python -m benchmarks.report
	$(BIN)/python -m benchmarks.optimality --resume
	$(BIN)/python -m benchmarks.speed
	$(BIN)/python -m benchmarks.proofs
	$(BIN)/python -m benchmarks.evidence

bench-smoke: $(VENV)/.dev  ## one small case of each benchmark
	$(BIN)/python -m benchmarks.optimality --smoke
	$(BIN)/python -m benchmarks.speed --smoke
	$(BIN)/python -m benchmarks.compare --smoke
	$(BIN)/python -m benchmarks.scale --smoke
	$(BIN)/python -m benchmarks.floor --smoke
	$(BIN)/python -m benchmarks.proofs --smoke
	$(BIN)/python -m benchmarks.evidence --smoke
	$(BIN)/python -m benchmarks.report --smoke
	$(BIN)/python -m benchmarks.proofs --smoke

$(VENV)/.base:
	$(PYTHON) -c 'import sys; sys.exit("evrelax needs Python 3.11 or later" if sys.version_info < (3, 11) else 0)'
	$(PYTHON) -m venv $(VENV)
	touch $@

$(VENV)/.run: $(VENV)/.base pyproject.toml
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -e .
	touch $@

$(VENV)/.dev: $(VENV)/.base pyproject.toml
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -e '.[dev,bench]'
	touch $@ $(VENV)/.run

clean:
	rm -rf $(VENV) build dist *.egg-info .pytest_cache .mypy_cache .ruff_cache .hypothesis
