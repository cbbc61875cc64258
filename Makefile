# Every target sets itself up: a virtual environment in .venv, from pip, with pinned versions.
PYTHON ?= python3
BIN := .venv/bin

.PHONY: demo test test-all fuzz lint bench architecture setup

demo: setup
	$(BIN)/pglog demo -o demo --overwrite

test: setup
	$(BIN)/python -m pytest

test-all: setup
	$(BIN)/python -m pytest -m ""

# Hostile files for everything that reads any; some five minutes.
fuzz: setup
	$(BIN)/python -m tests.fuzz --seconds 15

lint: setup
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

# The picture of docs/architecture.md, from the imports.
architecture: setup
	$(BIN)/python docs/draw_architecture.py

bench: setup
	$(BIN)/python -m benchmarks

setup: .venv/installed

.venv/installed: pyproject.toml constraints.txt
	$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "proground-log needs Python 3.11 or newer; set PYTHON=python3.11")'
	$(PYTHON) -m venv .venv
	$(BIN)/python -m pip install --quiet --upgrade pip
	$(BIN)/python -m pip install --quiet --constraint constraints.txt --editable '.[dev]'
	touch $@
