# `make demo` and `make test` need nothing but python3 (3.11 to 3.13) with pip.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
ARGS ?=

.DEFAULT_GOAL := help
.PHONY: help demo test wheel-tests proofs lint docs install clean

help:  ## list the targets
	@grep -E '^[a-z-]+:.*## ' $(MAKEFILE_LIST) | sed -E 's/:.*## /\t/' | expand -t 12

demo: $(VENV)/.installed  ## train and evaluate a policy (more options: make demo ARGS="seed=1")
	$(BIN)/python recipes/td3_bc.py $(ARGS)

test: $(VENV)/.installed-dev  ## tests, doctests and examples (choose: make test ARGS="-k critic")
	OMP_NUM_THREADS=1 $(BIN)/python -m pytest -n 2 --dist worksteal $(ARGS)

wheel-tests:  ## the tests against the wheel alone (choose: make wheel-tests PYTHON=python3.12 TESTS=tests/data)
	.ci/wheel_tests $(PYTHON) $(or $(TESTS),tests --pyargs torchgrasp) $(ARGS)

proofs: $(VENV)/.installed-dev  ## the slow tests: whole runs that are killed, on Ray, in sweeps
	OMP_NUM_THREADS=1 $(BIN)/python -m pytest -n 2 --dist worksteal -m slow $(or $(TESTS),tests) $(ARGS)

lint: $(VENV)/.installed-dev  ## style, formatting and types
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/pyright

docs: $(VENV)/.installed-docs  ## build the documentation into site/
	$(BIN)/mkdocs build --strict

install: $(VENV)/.installed  ## the library alone, editable

# pip runs again only where a requirement changed: each stamp is newer than both files.
$(VENV)/.installed: pyproject.toml constraints.txt | $(BIN)/pip
	$(BIN)/pip install --quiet --disable-pip-version-check -c constraints.txt -e .
	@touch $@

$(VENV)/.installed-%: pyproject.toml constraints.txt | $(BIN)/pip
	$(BIN)/pip install --quiet --disable-pip-version-check -c constraints.txt -e ".[$*]"
	@touch $@ $(VENV)/.installed

# Some systems ship python3 without ensurepip: their own pip then installs one.
$(BIN)/pip:
	$(PYTHON) -m venv $(VENV) || { $(PYTHON) -m venv --without-pip --clear $(VENV) && \
		$(PYTHON) -m pip --python $(BIN)/python install --quiet pip; }

clean:  ## remove what the other targets made, runs excepted
	rm -rf $(VENV) .venv-wheel site build dist *.egg-info .pytest_cache .ruff_cache
