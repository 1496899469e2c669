# The targets that a contributor needs; CI runs `make test`.
SHELL := /bin/bash
.SHELLFLAGS := -euo pipefail -c
.DEFAULT_GOAL := help

IN_ENVIRONMENT := . setup/environment.sh &&
PYTEST := python -m pytest -m "not slow and not browser"
# Two processes, each with whole files, for their graphs are shared by a file's tests.
PARALLEL := -n 2 --dist loadfile --no-loadscope-reorder

.PHONY: help setup test test-core test-all lint format bench

help:  ## this list
	@sed -nE 's/^([a-z-]+):.*## (.*)/  make \1\t\2/p' Makefile | expand -t 20

setup:  ## make .venv with everything needed
	@setup/setup.sh

lint: setup  ## linter, formatter and type checker
	@$(IN_ENVIRONMENT) ruff check .
	@$(IN_ENVIRONMENT) ruff format --check .
	@$(IN_ENVIRONMENT) mypy

# Graphs of real processes with deadlines: on a loaded machine discovery can miss one. What failed
# is run once more by itself and counts then; its names stand at the very end, for a test that often
# needs its second try is to be mended.
LAST_FAILED := .pytest_cache/v/cache/lastfailed
test: lint  ## what CI runs: lint and all tests but the slow ones and those with a browser
	@rm -f $(LAST_FAILED)
	@$(IN_ENVIRONMENT) $(PYTEST) $(PARALLEL) || { \
	  failed=$$(sed -nE 's/^ *"(.*)": true,?$$/  \1/p' $(LAST_FAILED)); \
	  echo "once more, what failed:"; code=0; $(PYTEST) --last-failed || code=$$?; \
	  printf 'failed the first time:\n%s\n' "$$failed"; exit $$code; }

test-core: setup  ## the tests of rapl_core, with every import of ROS blocked
	@$(IN_ENVIRONMENT) RAPL_TEST_WITHOUT_ROS=1 $(PYTEST) $(PARALLEL) tests/core

test-all: lint  ## every test; needs half an hour and, for the web page, a browser
	@$(IN_ENVIRONMENT) python -m pytest

format: setup  ## let ruff rewrite what it can
	@$(IN_ENVIRONMENT) ruff check --fix .
	@$(IN_ENVIRONMENT) ruff format .

bench: setup  ## world steps per second of the whole graph, and where the time goes
	@$(IN_ENVIRONMENT) python experiments/benchmark_graph.py
