# make demo: install (no torch) and see it work.   make test: install for development and run the tests.
PYTHON ?= python3
VENV ?= .venv
BIN := $(VENV)/bin
PIP := $(BIN)/python -m pip install --quiet --quiet --disable-pip-version-check -c constraints.txt
# One process a core, so one thread each.
TESTS := OMP_NUM_THREADS=1 $(BIN)/python -m pytest -q -n auto --dist loadfile
CODE := src tests scripts benchmarks
SOURCES := $(shell find src -type f -not -name '*.pyc')

.PHONY: demo test check smoke bench setup clean

# The development install can run the demo too; a plain install must not replace it.
demo: $(or $(wildcard $(VENV)/.dev),$(VENV)/.base)
	$(BIN)/mimesh demo

test: $(VENV)/.dev
	$(TESTS)

check: $(VENV)/.dev
	$(BIN)/ruff format --check $(CODE)
	$(BIN)/ruff check $(CODE)
	$(BIN)/pyright
	$(TESTS)

smoke: $(VENV)/.dev
	$(BIN)/python -m pytest -q tests/learn/test_smoke.py

bench: $(VENV)/.dev
	$(BIN)/python benchmarks/bench.py

setup: $(VENV)/.dev

$(VENV)/bin/python:
	$(PYTHON) -m venv $(VENV)

$(VENV)/.base: pyproject.toml constraints.txt $(SOURCES) | $(VENV)/bin/python
	$(PIP) .
	touch $@

$(VENV)/.dev: pyproject.toml constraints.txt | $(VENV)/bin/python
	$(PIP) -e '.[train,dev]'
	rm -f $(VENV)/.base
	touch $@

clean:
	rm -rf $(VENV) mimesh-demo build dist
