# make pipeline   set up, label the built-in drive, print and draw the result
# make test       set up, run the tests
# make lint docs  check style and types; write docs/pipeline.md
# make wheel-test build wheel and sdist, install the wheel elsewhere, label a short drive with it

PYTHON ?= python3
VENV ?= .venv
UPVL_COMMAND = $(VENV)/bin/upvl
NO_PLAN = test test-all lint docs setup wheel-test
include workspace.mk

$(OUT)/rules.mk: $(VENV)/.installed

$(VENV)/.installed: pyproject.toml constraints.txt
	@$(PYTHON) -c "import sys; sys.exit(sys.version_info < (3, 11))" || { echo "upvl needs Python 3.11 or newer; name one: make PYTHON=python3.12"; exit 1; }
	$(PYTHON) -m venv $(VENV)
	$(VENV)/bin/python -m pip install --quiet --constraint constraints.txt --editable '.[dev]'
	@touch $@

.PHONY: setup test test-all lint docs wheel-test
setup: $(VENV)/.installed

test: setup
	$(VENV)/bin/python -m pytest -n auto --dist loadgroup -m "not slow"

test-all: setup
	$(VENV)/bin/python -m pytest -n auto --dist loadgroup

lint: setup
	$(VENV)/bin/ruff check .
	$(VENV)/bin/ruff format --check .
	$(VENV)/bin/mypy

docs: setup
	$(UPVL) docs

wheel-test: setup
	PYTHON=$(VENV)/bin/python .ci/wheel
