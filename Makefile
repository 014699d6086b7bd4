# One word per chore. Every target does its own set-up (tools/setup.sh); nothing else has to be run first.
SHELL := /bin/sh
.DEFAULT_GOAL := help
PYTHON ?=
export PYTHON

# One thread per process: on a few cores the maths libraries' spinning threads cost more than they bring.
RUN_ENV := OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 NUMBA_THREADING_LAYER=omp
TEST_ENV := $(RUN_ENV) PYOPENGL_PLATFORM=egl
BIN := .venv/bin
PACKAGES := treegraph recon render sapwood
OUT ?= out
ARGS ?=

.PHONY: help demo test check format bench docs clean

help: ## this list
	@awk -F ':.*## ' '/^[a-z]+:.*## / {printf "make %-8s %s\n", $$1, $$2}' Makefile

demo: ## reconstruct the sample scans into out/ and say what was written
	@tools/setup.sh run
	@$(RUN_ENV) $(BIN)/reconstruct samples/*.laz --output $(OUT) --force $(ARGS)

test: ## run the test suite (make test ARGS="-k lobes" runs a part)
	@tools/setup.sh dev
	@$(TEST_ENV) $(BIN)/python -m pytest -q -n logical --maxprocesses=8 $(ARGS)

check: ## linter, formatting and types, without changing anything
	@tools/setup.sh dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

format: ## let the formatter and the linter's safe fixes rewrite the files
	@tools/setup.sh dev
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

bench: ## measure time, memory and accuracy (benchmarks/README.md)
	@tools/setup.sh dev
	@for script in benchmarks/bench_*.py; do echo "== $$script"; $(RUN_ENV) $(BIN)/python $$script $(ARGS) || exit 1; done

docs: ## write the generated pages (docs/commands.md) anew
	@tools/setup.sh run
	@$(BIN)/python tools/make_docs.py

clean: ## remove the environment and everything generated
	rm -rf .venv out build dist *.egg-info .pytest_cache .mypy_cache .ruff_cache .hypothesis
	find $(PACKAGES) tests -name __pycache__ -prune -exec rm -rf {} +
