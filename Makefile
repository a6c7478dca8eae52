# make demo: install (without PyTorch) and run the demo.   make test: install for development and run the quick tests.
PYTHON ?= python3
VENV ?= .venv
BIN := $(VENV)/bin
PIP := $(BIN)/python -m pip install --quiet --quiet --disable-pip-version-check -c constraints.txt
# One process a core, so one thread each.
# -rs: what is skipped, and why. Without reordering: files of few long tests would come last, for one of the processes.
TESTS := OMP_NUM_THREADS=1 $(BIN)/python -m pytest -q -rs -n auto --dist loadfile --no-loadscope-reorder
# Types and shapes of all arguments are checked at run time, which takes 1.75 times as long.
TYPED := --jaxtyping-packages=mimesh,beartype.beartype
# Blender 4.5 as a module is for Python 3.11 alone.
BLENDER_PYTHON ?= python3.11
BPY := .clients/bpy/bin/python
AXE := .clients/axe/node_modules/axe-core/axe.min.js
# Bytecode is kept: programs that tests start, and pytest itself, would compile every module again.
unexport PYTHONDONTWRITEBYTECODE
CODE := src tests scripts research benchmarks blender docs examples
SOURCES := $(shell find src -type f -not -name '*.pyc')

.PHONY: demo test test-all lint check smoke bench setup blender web clients docs release clean axe

# The development install can run the demo, too; a plain install must not replace it.
demo: $(or $(wildcard $(VENV)/.dev),$(VENV)/.base)
	$(BIN)/mimesh demo

test: $(VENV)/.dev
	$(TESTS)

# The slow tests, then the quick ones, TYPED: what slow ones call is called by quick ones, too.
test-all: $(VENV)/.dev
	$(TESTS) -m 'slow and not gpu and not client'
	$(TESTS) $(TYPED)

# Format, style, imports and types; pyright (standard) reads src, scripts and benchmarks, see pyproject.toml.
lint: $(VENV)/.dev
	$(BIN)/ruff format --check $(CODE)
	$(BIN)/ruff check $(CODE)
	$(BIN)/lint-imports --no-logo
	$(BIN)/pyright --pythonpath $(BIN)/python

check: lint test-all

smoke: $(VENV)/.dev
	$(BIN)/python -m pytest -q -m '' $(TYPED) tests/learn/test_smoke.py

bench: $(VENV)/.dev
	$(BIN)/python benchmarks/bench.py

setup: $(VENV)/.dev

blender: | $(BIN)/python
	$(BIN)/python scripts/build_blender.py

# The pages that show meshes: three.js and web/ in one file each, which are committed; only changing them needs Node.
web:
	cd web && npm ci --no-audit --no-fund && node build.mjs

# Checks the pages with axe-core, which tests of tests/browser skip without.
axe: $(VENV)/.dev $(AXE)
	OMP_NUM_THREADS=1 $(BIN)/python -m pytest -q -rs $(TYPED) -m '' tests/browser/test_accessibility.py

$(AXE):
	npm install --silent --prefix .clients/axe axe-core@4.14.1

# Other programs, each in an environment of its own; tests of one that cannot be installed are skipped and say so.
clients: $(VENV)/.dev
	-test -d .clients/validator || npm install --silent --prefix .clients/validator gltf-validator@2.0.0-dev.3.10
	-test -d .clients/three/node_modules/@pixiv/three-vrm-animation || npm install --silent --prefix .clients/three \
	  three@0.187.0 @pixiv/three-vrm@3.5.5 @pixiv/three-vrm-animation@3.5.5
	-test -d .clients/puppeteer || npm install --silent --prefix .clients/puppeteer puppeteer-core@24.43.1
	-test -x $(BPY) || { $(BLENDER_PYTHON) -m venv .clients/bpy && $(BPY) -m pip install --quiet bpy==4.5.15; }
	OMP_NUM_THREADS=1 MIMESH_FORMATS=docs/formats.json $(BIN)/python -m pytest -q -rs $(TYPED) -m client tests/clients

# The site, in docs/_build; then the links that lead out of it, which nothing here follows.
docs: $(VENV)/.dev
	PYTHONPATH=src $(BIN)/python -m sphinx -q -W --keep-going -b html docs docs/_build
	$(BIN)/python docs/_ext/links.py docs/_build

# Archives, checks, licences, SBOM and tag message in dist/release; see docs/contributing.md.
release: $(VENV)/.dev
	$(BIN)/python scripts/release.py

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
	rm -rf $(VENV) mimesh-demo build dist docs/_build
