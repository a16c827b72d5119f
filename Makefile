# Everything lives in .venv; nothing is installed elsewhere.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
OLD_VENV := .venv-opencv-4.10
# What formats, lints and checks the types of JavaScript: programs from npm, kept in the virtual environment. Vendored
# files are left alone.
NPM_PACKAGES := @biomejs/biome@2.6.8 typescript@5.9.3 openapi-typescript@7.13.0
NODE_MODULES := $(VENV)/node_modules
NODE_BIN := $(NODE_MODULES)/.bin
JAVASCRIPT := --config-path=tests/web/biome.jsonc src/stadimeter/web/static tests/support
ARGS ?=
# Bytecode is kept whatever the environment says: else each program that a test starts compiles all of it again, and
# pytest rewrites the assertions of every test file each time.
unexport PYTHONDONTWRITEBYTECODE
# The tests of one file together: they share what is costly to prepare. A worker that crashed is not replaced: with
# files kept together, the new one is given the test that crashed the last one, again and again. Two workers for each
# core: one computes while the other waits for processes and servers.
CORES := $(shell getconf _NPROCESSORS_ONLN)
WORKERS := $(shell expr 2 \* $(CORES))
SPREAD = -n $(WORKERS) --dist loadfile --no-loadscope-reorder --max-worker-restart 0
UNIT := tests/core tests/config tests/ranging

.PHONY: help demo quick test golden prove test-long test-sample test-opencv-4.10 nightly mutants check check-javascript gate bench bench-stopping pictures reference wheel deb lock docs format format-javascript clean

help: ## say what there is
	@grep -hE '^[a-z-]+:.*##' $(MAKEFILE_LIST) | sed 's/:.*## /\t/' | expand -t 12

demo: $(VENV)/.app ## a simulated world: watch a ball being measured, followed and reported
	$(BIN)/stadimeter demo $(ARGS)

quick: $(VENV)/.dev ## run the unit tests of core, config and ranging with few examples: half a minute
	HYPOTHESIS_PROFILE=quick $(BIN)/pytest $(SPREAD) -m "not long and not hardware" $(UNIT) $(ARGS)

test: $(VENV)/.collected ## run the tests; ARGS="-k name" passes arguments to pytest
	$(BIN)/pytest $(SPREAD) -m "not long and not hardware" $(ARGS)

golden: $(VENV)/.collected ## write the golden files anew, which say what must not change; ARGS="-k detectors" for a part
	$(BIN)/pytest $(SPREAD) tests/golden --write-golden $(ARGS)

test-long: $(VENV)/.collected ## run the tests that take longer
	$(BIN)/pytest $(SPREAD) -m "long and not hardware" $(ARGS)

test-sample: $(VENV)/.collected ## run long tests for ten minutes: of the folders that the change touches, and a sample
	$(BIN)/pytest $(SPREAD) -p support.long_sample -m "long and not hardware" $(ARGS)

test-opencv-4.10: $(OLD_VENV)/.dev ## run what differs between versions with the oldest OpenCV that is supported
	$(OLD_VENV)/bin/pytest $(SPREAD) -m "oldest_opencv and not long" $(ARGS)

nightly: $(VENV)/.nightly $(OLD_VENV)/.dev ## run everything, with a thousand new examples of each property: hours
	HYPOTHESIS_PROFILE=nightly $(BIN)/pytest $(SPREAD) -m "not hardware" --timeout 7200 $(ARGS)
	$(OLD_VENV)/bin/pytest $(SPREAD) -m vision $(ARGS)

mutants: $(VENV)/.nightly ## count which of 500 small mistakes in the code that guards people the tests notice: an hour
	$(BIN)/pytest $(SPREAD) -m "not long and not hardware" --cov=stadimeter --cov-context=test --cov-report=
	$(BIN)/python tests/benchmarks/mutants.py -o mutants.json $(ARGS)

check: $(VENV)/.dev check-javascript ## style, types and structure
	$(BIN)/ruff check
	$(BIN)/ruff format --check
	$(BIN)/mypy
	$(BIN)/lint-imports

ifeq ($(shell command -v npm),)
check-javascript format-javascript:
	@echo "The JavaScript of the page is left out: npm is missing. On Debian: sudo apt install npm"
else
check-javascript: $(NODE_MODULES) $(VENV)/.dev
	$(NODE_BIN)/biome check --error-on-warnings $(JAVASCRIPT)
	$(BIN)/python docs/openapi.py > $(VENV)/openapi.json
	$(NODE_BIN)/openapi-typescript $(VENV)/openapi.json --empty-objects-unknown -o $(VENV)/openapi.d.ts > /dev/null
	$(NODE_BIN)/tsc -p tests/web

format-javascript: $(NODE_MODULES)
	$(NODE_BIN)/biome check --write $(JAVASCRIPT)
endif

gate: $(VENV)/.dev ## compare what start-up, memory and a cycle cost with the kept figures; ARGS=--keep keeps new ones
	PYTHONPATH=tests $(BIN)/python tests/benchmarks/gate.py $(ARGS)

format: $(VENV)/.dev format-javascript ## put the code in order
	$(BIN)/ruff check --fix
	$(BIN)/ruff format

bench: $(VENV)/.bench ## measure accuracy and speed on rendered pictures; ARGS="--only ball --frames 60" for a part
	PYTHONPATH=tests $(BIN)/python tests/benchmarks/run.py $(ARGS)

prove: $(VENV)/.dev ## try every pair of faults for every base, for the table of docs/benchmarks/proof.md; ARGS="robot.toml" for one
	@PYTHONPATH=tests $(BIN)/python -m scenario.prove $(ARGS)

bench-stopping: $(VENV)/.dev ## end the program in every way, and time how long the wheels of its robot are driven on
	PYTHONPATH=tests $(BIN)/python tests/benchmarks/stopping.py $(ARGS)

pictures: $(VENV)/.dev ## make the pictures of the documentation again
	PYTHONPATH=tests $(BIN)/python docs/pictures/make_pictures.py

reference: $(VENV)/.dev ## write the pages of docs/reference/ again, from the code
	PYTHONPATH=tests $(BIN)/python docs/make_reference.py

wheel: $(VENV)/.pip ## build the wheel into dist/, for `pip install dist/stadimeter-*.whl` on another machine
	$(BIN)/python -m pip wheel --quiet --no-deps --wheel-dir dist .
	@echo "Built: $$(ls -t dist/stadimeter-*.whl | head -n 1)"

deb: $(VENV)/.pip ## make the Debian package; ARGS="--release bookworm --arch arm64" for another machine
	SOURCE_DATE_EPOCH=$${SOURCE_DATE_EPOCH:-$$(git log -1 --format=%ct || date +%s)} PYTHONUTF8=1 $(BIN)/python deploy/make_deb.py $(ARGS)

lock: $(VENV)/.pip ## choose the libraries of the Debian package anew, from the ranges of pyproject.toml: deploy/debian/*.lock
	$(BIN)/python -m pip install --quiet uv
	PYTHONPATH=deploy $(BIN)/python -c 'import make_deb; make_deb.lock()'

docs: $(VENV)/.docs ## build the documentation as a site into site/, and check its links and its search
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --clean
	$(BIN)/pytest tests/docs/test_site.py $(ARGS)
	@echo "The site is in site/. To read and search it: $(BIN)/python -m http.server -d site"

clean: ## remove what the other targets made
	rm -rf $(VENV) $(OLD_VENV) .mypy_cache .ruff_cache .hypothesis .import_linter_cache site

$(VENV)/.python:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { \
		echo "stadimeter needs Python 3.11 or newer, and $(PYTHON) is not. Name another one: make PYTHON=python3.12 ..."; exit 1; }
	@$(PYTHON) -c 'import ensurepip' 2>/dev/null || { \
		echo "$(PYTHON) cannot make virtual environments here. On Debian: sudo apt install python3-venv"; exit 1; }
	@echo "Making a virtual environment in $(VENV) ..."
	@$(PYTHON) -m venv $(VENV)
	@touch $@

$(VENV)/.app: $(VENV)/.python pyproject.toml
	@echo "Installing stadimeter and its libraries there, once: about 290 MB on the disk, half a minute to a few minutes."
	@$(BIN)/python -m pip install --disable-pip-version-check --no-compile --editable ".[web]"
	@touch $@

$(VENV)/.pip: $(VENV)/.app
	$(BIN)/python -m pip install --quiet --upgrade 'pip>=25.3'
	@touch $@

$(VENV)/.dev: $(VENV)/.pip
	$(BIN)/python -m pip install --quiet --group dev
	@touch $@

# pytest rewrites the assertions of each file once and keeps the result; else each worker would do it for all files.
$(VENV)/.collected: $(VENV)/.dev
	@find tests -name 'test_*.py' | xargs -P $(CORES) -n 150 $(BIN)/pytest --collect-only -qq >/dev/null 2>&1 || true
	@touch $@

$(VENV)/.nightly: $(VENV)/.collected
	$(BIN)/python -m pip install --quiet --group nightly
	@touch $@

$(NODE_MODULES): Makefile | $(VENV)/.python
	npm install --prefix $(VENV) --no-save --no-audit --no-fund --silent $(NPM_PACKAGES)
	@touch $@

$(VENV)/.bench: $(VENV)/.pip pyproject.toml
	$(BIN)/python -m pip install --quiet --group bench
	@touch $@

$(VENV)/.docs: $(VENV)/.dev pyproject.toml
	$(BIN)/python -m pip install --quiet --group docs
	@touch $@

$(OLD_VENV)/.dev: pyproject.toml
	$(PYTHON) -m venv $(OLD_VENV)
	$(OLD_VENV)/bin/python -m pip install --quiet --upgrade 'pip>=25.3'
	$(OLD_VENV)/bin/python -m pip install --quiet --editable . --group dev 'opencv-python-headless==4.10.*'
	@touch $@
