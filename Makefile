# Every target sets itself up: a virtual environment of its own, from pip. `make help` lists them.
PYTHON ?= python3
BIN := .venv/bin
OLDEST := .venv-oldest
NEWEST := .venv-newest
TAG ?=
VERSION = $(shell sed -n 's/^__version__ = "\(.*\)"/\1/p' proground_log/version.py)

# What makes a virtual environment: $(call environment,FOLDER,OPTIONS OF pip install).
define environment
$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "proground-log needs Python 3.11 or newer; set PYTHON=python3.11")'
$(PYTHON) -m venv $(1)
$(1)/bin/python -m pip install --quiet --upgrade pip
$(1)/bin/python -m pip install --quiet $(2)
endef

.PHONY: help demo setup lint style format types layers test test-fast test-all test-oldest test-newest test-wheel
.PHONY: test-gpu wheel check-tag notes fuzz architecture bench clean

help: ## what can be made
	@sed -n 's/^\([a-z-]*\):.*## /\1: /p' Makefile | awk -F': ' '{ printf "%-12s %s\n", $$1, $$2 }'

demo: setup ## record the built-in room, perceive, map, judge and ask; about three minutes
	$(BIN)/pglog demo -o demo --overwrite

test: setup ## the test suite
	$(BIN)/python -m pytest

test-fast: setup ## most of it, in two minutes
	$(BIN)/python -m pytest -m "not long and not slow"

test-all: setup ## the tests that take minutes too
	$(BIN)/python -m pytest -m ""

test-oldest: $(OLDEST)/installed ## the suite with the oldest packages that are supported
	$(OLDEST)/bin/python -m pytest

test-newest: ## the suite with the newest packages there are, installed anew each time
	rm -rf $(NEWEST)
	$(call environment,$(NEWEST),--editable '.[test]')
	$(NEWEST)/bin/python -m pip freeze --exclude-editable
	$(NEWEST)/bin/python -m pytest

test-wheel: setup ## the suite on an installed wheel, away from the checkout
	$(BIN)/python -m pytest -m "" tests/test_wheel.py

test-gpu: setup ## replays on a GPU, on a machine that has one
	$(BIN)/python -c 'import sys, torch; sys.exit(not torch.cuda.is_available() and "torch sees no CUDA device here")'
	$(BIN)/python -m pytest -m "" tests/test_gpu.py

fuzz: setup ## hostile files for everything that reads any; some five minutes
	$(BIN)/python -m tests.fuzz --seconds 15

lint: style types layers ## all that can be said without running

style: setup ## ruff, style and format
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

format: setup ## ruff again, which mends what it can
	$(BIN)/ruff check --quiet --fix-only .
	$(BIN)/ruff format .

types: setup ## mypy, strict
	$(BIN)/mypy

layers: setup ## import-linter: layers point one way
	$(BIN)/lint-imports

architecture: setup ## draw the picture of docs/architecture.md, from the imports
	$(BIN)/python docs/draw_architecture.py

bench: setup ## speed, quality and memory, with ratios
	$(BIN)/python -m benchmarks

wheel: setup ## build the wheel and the source distribution, in dist/
	rm -rf dist
	$(BIN)/python -m build --no-isolation

check-tag: ## whether TAG=v1.2.3 is the version of the code, and stands in the changelog
	test "$(TAG)" = "v$(VERSION)"
	grep -q '^## \[$(VERSION)\] - ' CHANGELOG.md

notes: ## what the changelog says of this version, in release-notes.md
	awk '/^## /{p = index($$0, "## [$(VERSION)]") == 1; next} p' CHANGELOG.md > release-notes.md
	test -s release-notes.md

clean: ## remove what was built, the virtual environments too
	rm -rf dist .venv $(OLDEST) $(NEWEST)

setup: .venv/installed ## the virtual environment .venv, with pinned versions

.venv/installed: pyproject.toml constraints.txt proground_log/version.py
	$(call environment,.venv,--constraint constraints.txt --editable '.[dev]')
	touch $@

$(OLDEST)/installed: pyproject.toml constraints-oldest.txt proground_log/version.py
	$(call environment,$(OLDEST),--constraint constraints-oldest.txt --editable '.[test]')
	touch $@
