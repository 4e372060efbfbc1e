# make pipeline   set up, label the built-in drive, print and draw the result
# make test       set up, run the tests
# make demo       write docs/demo.html and docs/city.webp from the labels of the built-in drive (after make pipeline)
# make lint docs  check style and types; write docs/pipeline.md
# make wheel-test build wheel and sdist, install the wheel elsewhere, label a short drive with it

PYTHON ?= python3
VENV ?= .venv
UPVL_COMMAND = $(VENV)/bin/upvl
NO_PLAN = test test-all lint docs demo setup wheel-test
include workspace.mk

$(OUT)/rules.mk: $(VENV)/.installed

$(VENV)/.installed: pyproject.toml constraints.txt
	@$(PYTHON) -c "import sys; sys.exit(sys.version_info < (3, 11))" || { echo "upvl needs Python 3.11 or newer; name one: make PYTHON=python3.12"; exit 1; }
	$(PYTHON) -m venv $(VENV)
	$(VENV)/bin/python -m pip install --quiet --constraint constraints.txt --editable '.[dev]'
	@touch $@

.PHONY: setup test test-all lint docs demo wheel-test
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

demo: setup
	$(UPVL) report -s train-000 --to docs/demo.html
	$(UPVL) draw train-000 --animate
	cp $(OUT)/draw/train-000.webp docs/city.webp

wheel-test: setup
	PYTHON=$(VENV)/bin/python .ci/wheel
