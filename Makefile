# Start with `make demo` and `make test`. All targets use the virtual environment .venv, which the first target creates.

PYTHON ?= python3
BIN := .venv/bin
TEST_SEED := 1000000  # seed of the first test episode; no policy is tuned or trained on the test episodes

.PHONY: help demo test check check-extras check-lowest format bench golden accuracy docs flying results dist clean
.DEFAULT_GOAL := help

help:  ## list the targets
	@sed -n 's/^\([a-z-]*\):.*  ## \(.*\)/  \1\t\2/p' $(MAKEFILE_LIST) | expand -t 18

demo: .venv/.installed  ## train PPO in wind for a minute and compare it with ADRC-DESO and the flatness-based controller
	rm -rf runs/demo
	$(BIN)/quadpend train --settings ppo-alone --total-timesteps 1200000 --out runs/demo
	$(BIN)/quadpend evaluate adrc-paper flatness ppo=runs/demo --scenarios calm windy --episodes 200 --seed $(TEST_SEED) --out results/demo

WORKERS := auto  # processes that run the tests; 0 runs them in one process
test: .venv/.installed  ## run the tests
	OMP_NUM_THREADS=1 $(BIN)/python -m tests.helpers.kernels
	OMP_NUM_THREADS=1 $(BIN)/python -m pytest -m "not extras" -n $(WORKERS) --dist loadfile --no-loadscope-reorder

check: .venv/.installed  ## run what CI runs first: format, lint, types, imports, docs, tests
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy
	$(BIN)/lint-imports
	$(MAKE) docs test

check-extras: .venv/.installed  ## run the tests that need Betaflight, or take long; what is missing is skipped with a reason
	OMP_NUM_THREADS=1 PIP_CONSTRAINT=$(CURDIR)/constraints.txt $(BIN)/python -m pytest -m extras -rs

check-lowest: .venv-lowest/.installed  ## run the tests of the packages with the lowest versions that pyproject.toml permits
	$(LOWEST) -m tests.helpers.kernels
	$(LOWEST) -m pytest -m "not extras" -W ignore::DeprecationWarning -n $(WORKERS) --dist loadfile tests/quadpend_gym tests/quadpend_baselines tests/quadpend_train

LOWEST := OMP_NUM_THREADS=1 NUMBA_CACHE_DIR=$(CURDIR)/.venv-lowest/numba .venv-lowest/bin/python
.venv-lowest/.installed: .venv/.installed
	$(BIN)/uv venv --quiet --clear --python $(BIN)/python $(@D)
	UV_FIND_LINKS="$(PIP_FIND_LINKS)" $(BIN)/uv pip install --quiet --python $(@D)/bin/python --resolution lowest-direct --editable '.[train,view,mpc,logs,control,dev]'
	touch $@

format: .venv/.installed  ## format the code and fix what ruff can fix
	$(BIN)/ruff format .
	$(BIN)/ruff check --fix .

bench: .venv/.installed  ## docs/accuracy.md: speed, compared with other environments and, if installed, the extra `peers`
	OMP_NUM_THREADS=1 $(BIN)/python -m benchmarks.speed
	OMP_NUM_THREADS=1 SCIPY_ARRAY_API=1 $(BIN)/python -m benchmarks.peers

golden: .venv/.installed  ## hashes of results: written on the first run, compared on the next; run before and after a refactoring
	$(BIN)/python -m benchmarks.golden

accuracy: .venv/.installed  ## docs/accuracy.md: energy drift, distance from MuJoCo, coverage of intervals, error rates of tests
	OMP_NUM_THREADS=1 $(BIN)/python -m benchmarks.accuracy

docs: .venv/.installed  ## build the documentation site in site/; a broken link or a missing reference is an error
	$(BIN)/python -m docs.tools.schemas
	NO_MKDOCS_2_WARNING=1 $(BIN)/python -m mkdocs build --strict --quiet

flying: .venv/.installed  ## docs/flying.html, with the vehicle and policies compiled to WebAssembly; needs clang and lld
	$(BIN)/python -m docs.tools.flying_page

EXPERIMENTS := $(basename $(notdir $(shell grep -l __main__ experiments/*.py)))
results: .venv/.installed  ## the published pages of results; EXPERIMENTS=name runs only experiments/name.py
	$(foreach name,$(EXPERIMENTS),$(BIN)/python -m experiments.$(name) &&) true

dist:  ## build sdist and wheel in dist/, and check what PyPI checks
	rm -rf build dist
	$(PYTHON) -m venv build/venv
	build/venv/bin/python -m pip install --quiet build twine
	build/venv/bin/python -m build --outdir dist >build/log || (cat build/log; false)
	build/venv/bin/twine check --strict dist/*

clean:  ## delete the caches of numba and of the tools
	find . -name __pycache__ -not -path './.venv*' -prune -exec rm -rf {} +
	rm -rf site .pytest_cache .mypy_cache .ruff_cache .import_linter_cache .hypothesis build dist *.egg-info

.venv/.installed: pyproject.toml constraints.txt
	$(PYTHON) -c 'import sys; sys.exit("Python 3.10 or newer is needed, not " + sys.version.split()[0] if sys.version_info < (3, 10) else 0)'
	$(PYTHON) -m venv .venv
	$(BIN)/python -m pip install --quiet --constraint constraints.txt --editable '.[train,view,dev,docs]'
	touch $@
