# make demo     track a simulated city drive with several filters; reproduce the papers; write both reports
# make test     the whole test suite
# make check    ruff and mypy --strict
# make validate reproduce every table and figure of the papers, at length
# make bench    speed against peers, as ratios
# make docs     the documentation
# Each works on a fresh machine that has make and Python 3.11 or newer; the environment goes to .venv.

SHELL := /bin/sh
.DEFAULT_GOAL := help
.PHONY: help demo test check format validate bench docs clean
.NOTPARALLEL:

# The first interpreter that is new enough; `make PYTHON=/path/to/python3 ...` overrides.
PYTHON ?= $(shell for python in python3 python3.13 python3.12 python3.11 python3.14 python; do \
	$$python -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null && { echo $$python; break; }; done)

VENV := .venv
BIN := $(VENV)/bin
PIP := $(BIN)/python -m pip --disable-pip-version-check
RECIPE := pyproject.toml constraints.txt
EXTRAS := $(addprefix $(VENV)/.,validation dev docs bench)
TRACKERS := norfair motpy ocsort

# One thread per process: small matrices gain nothing from more, and the tests run in parallel.
export OMP_NUM_THREADS := 1
export OPENBLAS_NUM_THREADS := 1

# Recorded tracks, where they lie beside the checkout; tests that need them skip elsewhere.
ifeq ($(origin UFIREXT_DATA),undefined)
ifneq ($(wildcard ../shared/data),)
export UFIREXT_DATA := $(abspath ../shared/data)
endif
endif

help:
	@sed -n 's/^# make/make/p' Makefile

demo: $(VENV)/.validation
	$(BIN)/ufirext demo --out out/demo
	$(BIN)/python -m validation --quick --out out/validation

test: $(VENV)/.dev $(VENV)/.trackers
	$(BIN)/python -m pytest -n 2 $(TESTS)

check: $(VENV)/.dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

format: $(VENV)/.dev
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

validate: $(VENV)/.validation
	$(BIN)/python -m validation --full --out out/validation

bench: $(VENV)/.bench $(VENV)/.trackers
	$(BIN)/python -m benchmarks

docs: $(VENV)/.docs
	$(BIN)/sphinx-build -n -W --keep-going -b html docs docs/_build/html
	@echo "Documentation: $(abspath docs/_build/html/index.html)"

clean:
	rm -rf $(VENV) build dist out docs/_build docs/generated docs/gallery .pytest_cache .mypy_cache .ruff_cache .hypothesis
	find . -name __pycache__ -type d -prune -exec rm -rf {} +

# Stamps: rebuilt when the dependencies change, so that a second run starts at once.
$(VENV)/.made:
	@test -n "$(PYTHON)" || { \
		echo "ufirext needs Python 3.11 or newer; python3 here is: $$(python3 --version 2>&1)." >&2; \
		echo "Install a newer one, or name it: make PYTHON=/path/to/python3.12 $(MAKECMDGOALS)" >&2; exit 1; }
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { \
		echo "ufirext needs Python 3.11 or newer; $(PYTHON) is $$($(PYTHON) --version 2>&1)." >&2; exit 1; }
	@echo "Creating $(VENV) with $$($(PYTHON) --version)"
	$(PYTHON) -m venv $(VENV)
	@touch $@

$(EXTRAS): $(VENV)/.%: $(RECIPE) | $(VENV)/.made
	@echo "Installing ufirext[$*] into $(VENV): a minute or two, once"
	$(PIP) install -c constraints.txt -e ".[$*]"
	@touch $@

# Trackers whose metadata ask for older releases of NumPy or filterpy than they need.
$(VENV)/.trackers: $(RECIPE) | $(VENV)/.made
	$(PIP) install -c constraints.txt --no-deps $(TRACKERS)
	@touch $@
