# setup | demo | test | test-all | coverage | check | docs | bench | format; each sets up what it needs on a fresh machine.
PYTHON ?= python3
VENV ?= .venv
BIN := $(VENV)/bin

# Processes that run tests; 0 = none beside pytest itself, which a debugger needs.
WORKERS ?= logical
# Compiled files are kept even where the environment says otherwise: half of the collection is compiling tests.
PYTEST := PYTHONDONTWRITEBYTECODE= $(BIN)/python -m pytest --numprocesses $(WORKERS) --maxprocesses 8 --dist worksteal --tiers-file=out/tiers.json
SLOW_TIERS := slow or train or browser or real
ifdef COVERAGE
PYTEST += --cov --cov-append --cov-report=
endif

.PHONY: setup demo test test-slow test-all coverage check docs bench format clean

$(BIN)/python:
	$(PYTHON) -m venv $(VENV)

# Two stamps, so that a demo does not wait for the developers' tools.
$(VENV)/.runtime: pyproject.toml | $(BIN)/python
	$(BIN)/python -m pip install --quiet --editable .
	touch $@

$(VENV)/.dev: pyproject.toml | $(BIN)/python
	$(BIN)/python -m pip install --quiet --editable '.[dev]'
	touch $@ $(VENV)/.runtime

# OpenCV 5 no longer reads Darknet's files, OpenCV 4 does: the tests compare our importer with it.
$(VENV)/.opencv4: | $(BIN)/python
	$(PYTHON) -m venv $(VENV)/opencv4
	$(VENV)/opencv4/bin/python -m pip install --quiet 'opencv-python-headless>=4.10,<5'
	touch $@

# ASAM's checkers require a NumPy before 2.
$(VENV)/.validators: | $(BIN)/python
	$(PYTHON) -m venv $(VENV)/validators
	$(VENV)/validators/bin/python -m pip install --quiet 'asam-qc-opendrive>=1,<2' 'asam-qc-openscenarioxml>=1,<2'
	touch $@

$(VENV)/.docs: pyproject.toml | $(BIN)/python
	$(BIN)/python -m pip install --quiet --editable '.[docs]'
	touch $@ $(VENV)/.runtime

setup: $(VENV)/.dev $(VENV)/.opencv4 $(VENV)/.validators

demo: $(VENV)/.runtime
	$(BIN)/track-range demo --out out/demo

# The fast tier: every package in minutes.
test: $(VENV)/.dev
	$(PYTEST) -m 'not ($(SLOW_TIERS))'

# The tiers that `make test` leaves out; tests/tiers.py says what they are.
test-slow: $(VENV)/.dev $(VENV)/.opencv4 $(VENV)/.validators
	$(PYTEST) -m '$(SLOW_TIERS)'

test-all: test test-slow

# Branch coverage of all tiers.
coverage: $(VENV)/.dev
	$(BIN)/coverage erase
	$(MAKE) test-all COVERAGE=yes
	$(BIN)/coverage report --skip-covered

check: $(VENV)/.dev
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy
	$(BIN)/python .ci/word_list.py

# The pages are in out/docs, ready to be opened as files.
docs: $(VENV)/.docs
	NO_MKDOCS_2_WARNING=1 $(BIN)/python -m mkdocs build --strict --quiet

bench: $(VENV)/.dev
	$(BIN)/python -m pip install --quiet --editable '.[bench]'
	$(BIN)/python -m benchmarks pipeline

format: $(VENV)/.dev
	$(BIN)/ruff format .
	$(BIN)/ruff check --fix .

clean:
	rm -rf $(VENV) out .coverage .mypy_cache .pytest_cache .ruff_cache
