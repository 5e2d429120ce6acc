# scanrender: `make demo` and `make test` do everything from a fresh clone; `make help` lists the rest.
#
# The environment is .venv, installed with the exact versions of constraints.txt. Nothing is
# installed again until pyproject.toml or constraints.txt changes.

SHELL := /bin/bash
.DEFAULT_GOAL := help
.PHONY: help system venv demo test lint format docs wheel clean

VENV ?= .venv
OUT ?= out/demo
ARGS ?=
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed

# Test processes. More than four only fill the memory: each has its own GL context.
WORKERS ?= $(shell n=$$(getconf _NPROCESSORS_ONLN 2>/dev/null || echo 2); echo $$(( n < 4 ? n : 4 )))

# Mesa and EGL say on stderr what they tried on the way to a driver that works.
export EGL_LOG_LEVEL ?= fatal
export PIP_DISABLE_PIP_VERSION_CHECK := 1
export PIP_ROOT_USER_ACTION := ignore

help:  ## Show this list
	@grep -E '^[a-z]+:.*##' $(MAKEFILE_LIST) | sed -E 's/^([a-z]+):.*## */\1|/' \
		| while IFS='|' read -r name text; do printf '  make %-8s %s\n' "$$name" "$$text"; done

demo: $(STAMP)  ## Make a raw head, prepare it, render its turntable into out/demo
	@$(BIN)/scanrender demo --out $(OUT) $(ARGS)

# One thread a process for BLAS: the processes share the cores already.
test: $(STAMP)  ## Run all tests (ARGS="-k name" for some)
	@OPENBLAS_NUM_THREADS=1 $(BIN)/python -m pytest -n $(WORKERS) $(ARGS)

lint: $(STAMP)  ## Check style (ruff) and types (mypy)
	@$(BIN)/ruff check .
	@$(BIN)/ruff format --check --quiet . || { echo "to do: make format" >&2; exit 1; }
	@$(BIN)/mypy

format: $(STAMP)  ## Format the code, sort the imports
	@$(BIN)/ruff check --quiet --select I --fix .
	@$(BIN)/ruff format --quiet .

docs: $(STAMP)  ## Write the generated pages and the JSON Schema anew
	@$(BIN)/python tools/make_docs.py

wheel: $(STAMP)  ## Build the wheel into dist/
	@$(BIN)/python -m pip wheel -q --no-deps --no-build-isolation -w dist .
	@ls dist/*.whl

venv: $(STAMP)  ## Make .venv only

system:  ## See to the system libraries only
	@tools/system_packages.sh

clean:  ## Remove .venv, dist and caches; out/ stays
	rm -rf $(VENV) dist build .pytest_cache .mypy_cache .ruff_cache .hypothesis
	find . -name __pycache__ -type d -prune -exec rm -rf {} +

$(STAMP): pyproject.toml constraints.txt
	@tools/system_packages.sh
	@python=$$(tools/find_python.sh) && echo "setting up $(VENV) with $$($$python --version)" && \
		{ $(BIN)/python -m pip --version >/dev/null 2>&1 || $$python -m venv --clear $(VENV); }
	@$(BIN)/python -m pip install -q -c constraints.txt hatchling editables
	@$(BIN)/python -m pip install -q -c constraints.txt --no-build-isolation -e '.[dev,dask]'
	@touch $@
