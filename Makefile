# Everything lives in .venv; nothing is installed elsewhere.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
ARGS ?=

.PHONY: help demo test check pictures format clean

help: ## say what there is
	@grep -hE '^[a-z-]+:.*##' $(MAKEFILE_LIST) | sed 's/:.*## /\t/' | expand -t 12

demo: $(VENV)/.app ## a simulated world: watch a ball being measured, followed and reported
	$(BIN)/stadimeter demo $(ARGS)

test: $(VENV)/.dev ## run the tests; ARGS="-k name" passes arguments to pytest
	$(BIN)/pytest $(ARGS)

check: $(VENV)/.dev ## style, types and structure
	$(BIN)/ruff check
	$(BIN)/ruff format --check
	$(BIN)/mypy
	$(BIN)/lint-imports

format: $(VENV)/.dev ## put the code in order
	$(BIN)/ruff check --fix
	$(BIN)/ruff format

pictures: $(VENV)/.dev ## make the pictures of the documentation again
	$(BIN)/python docs/pictures/make_pictures.py

clean: ## remove what the other targets made
	rm -rf .venv .venv-opencv-4.10 .mypy_cache .ruff_cache .hypothesis .import_linter_cache

$(VENV)/.python:
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --upgrade 'pip>=25.1'
	@touch $@

$(VENV)/.app: $(VENV)/.python pyproject.toml
	$(BIN)/python -m pip install --quiet --editable .
	@touch $@

$(VENV)/.dev: $(VENV)/.app
	$(BIN)/python -m pip install --quiet --group dev
	@touch $@
