# setup | demo | test | check | bench | format; demo and test do all the set-up on a fresh machine.
PYTHON ?= python3
VENV ?= .venv
BIN := $(VENV)/bin

.PHONY: setup demo test check bench format clean

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

setup: $(VENV)/.dev $(VENV)/.opencv4

demo: $(VENV)/.runtime
	$(BIN)/track-range demo --out out/demo

test: $(VENV)/.dev $(VENV)/.opencv4
	$(BIN)/python -m pytest

check: $(VENV)/.dev
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy

bench: $(VENV)/.dev
	$(BIN)/python -m pip install --quiet --editable '.[bench]'
	$(BIN)/python -m benchmarks pipeline

format: $(VENV)/.dev
	$(BIN)/ruff format .
	$(BIN)/ruff check --fix .

clean:
	rm -rf $(VENV) out .mypy_cache .pytest_cache .ruff_cache
