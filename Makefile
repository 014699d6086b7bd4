# One word per chore. Every target does its own set-up (tools/setup.sh); nothing else has to be run first.
SHELL := /bin/sh
.DEFAULT_GOAL := help
PYTHON ?=
export PYTHON

BIN := .venv/bin
PACKAGES := treegraph recon classify species inverse plastic render sapwood
OUT ?= demo-output
ARGS ?=

# One thread per process: on a few cores the maths libraries' spinning threads cost more than they bring.
RUN_ENV := OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1
# Open3D brings an older TBB along, which numba would warn about; OpenMP is the layer to take where it is there.
HAS_OPENMP := $(shell PATH="$$PATH:/sbin:/usr/sbin" ldconfig -p 2>/dev/null | grep -m 1 -o 'libgomp\.so\.1$$')
TEST_ENV := $(RUN_ENV) PYOPENGL_PLATFORM=egl $(if $(HAS_OPENMP),NUMBA_THREADING_LAYER=omp)

.PHONY: help demo test check format bench results docs clean

help: ## this list
	@awk -F ':.*## ' '/^[a-z]+:.*## / {printf "make %-8s %s\n", $$1, $$2}' Makefile

demo: ## reconstruct the sample scans into demo-output/ and say what was written
	@tools/setup.sh run
	@$(RUN_ENV) $(BIN)/python tools/demo.py $(OUT) $(ARGS)

test: ## run the tests but the slow ones (ARGS="-k lobes" runs a part, ARGS="-m slow" the slow ones)
	@tools/setup.sh dev
	@$(TEST_ENV) $(BIN)/python -m pytest -q -n auto --maxprocesses=4 -m "not slow" $(ARGS)

check: ## linter, formatting and types, without changing anything
	@tools/setup.sh dev
	@status=0; for chore in "ruff check ." "ruff format --check ." mypy; do \
		echo "$$chore"; $(BIN)/$$chore || status=1; done; exit $$status

format: ## let the formatter and the linter's safe fixes rewrite the files
	@tools/setup.sh dev
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

bench: ## measure time, memory and accuracy: make bench ARGS="--data DIR" (docs/benchmarks.md)
	@tools/setup.sh dev
	@$(RUN_ENV) $(BIN)/python -m benchmarks $(ARGS)

results: ## write docs/results.md anew: make results ARGS="--data DIR"
	@tools/setup.sh dev
	@$(RUN_ENV) $(BIN)/python tools/make_results.py $(ARGS)

docs: ## write docs/commands.md, the README's pictures and the output of its examples anew
	@tools/setup.sh dev
	@$(RUN_ENV) $(BIN)/python tools/make_docs.py

clean: ## remove the environment and everything generated
	rm -rf .venv demo-output build dist *.egg-info .pytest_cache .mypy_cache .ruff_cache .hypothesis
	find $(PACKAGES) benchmarks tests -name __pycache__ -prune -exec rm -rf {} +
