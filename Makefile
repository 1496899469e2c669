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
# is run once more by itself and counts then; both summaries are printed.
test: lint  ## what CI runs: lint and all tests but the slow ones and those with a browser
	@$(IN_ENVIRONMENT) $(PYTEST) $(PARALLEL) || { echo "once more, what failed:"; $(PYTEST) --last-failed; }

test-core: setup  ## the tests of rapl_core, with every import of ROS blocked
	@$(IN_ENVIRONMENT) RAPL_TEST_WITHOUT_ROS=1 $(PYTEST) $(PARALLEL) tests/core

test-all: lint  ## every test; needs half an hour and, for the web page, a browser
	@$(IN_ENVIRONMENT) python -m pytest

format: setup  ## let ruff rewrite what it can
	@$(IN_ENVIRONMENT) ruff check --fix .
	@$(IN_ENVIRONMENT) ruff format .

bench: setup  ## world steps per second of the whole graph, and where the time goes
	@$(IN_ENVIRONMENT) python experiments/benchmark_graph.py
