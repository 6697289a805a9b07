# `make demo` and `make test` set up what they need first; the second time that costs nothing.
# Another interpreter gets an environment of its own: `make test PYTHON=python3.12`.

PYTHON ?= python3
VENV ?= .venv$(addprefix -,$(filter-out python3,$(notdir $(PYTHON))))
BIN := $(VENV)/bin
SITE := .venv-site
# Python compiles what it imports, when it does: the rest need not be.
PIP_INSTALL := $(BIN)/python -m pip install -qq --disable-pip-version-check --no-compile
# Tests of the node wait for it most of the time: more of them than there are processors run side by side.
# One that hangs fails, and says where; the longest takes a minute.
PYTEST_ARGS ?= --numprocesses 3 --dist loadscope --timeout 600
BENCH_ARGS ?=
# The tests start many processes: what is compiled is kept, or each would compile it anew.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: help setup demo test quick lint docs pictures site dist bench colcon clean

help: ## List these targets
	@awk -F ':.*## ' '/^[a-z]+:.*## / { printf "make %-8s %s\n", $$1, $$2 }' $(MAKEFILE_LIST)

setup: $(VENV)/.run-ready ## Set up what running needs

demo: $(VENV)/.run-ready ## Set up, then run the demonstration
	$(BIN)/geomid demo --rate 2 --out out/demo

test: lint ## Set up, then run the static checks and the tests
	$(BIN)/python -m pytest $(PYTEST_ARGS)

quick: $(VENV)/.test-ready ## Set up, then run ruff and the first case of every test that needs no ROS, no simulation and not many robots
	$(BIN)/ruff check
	$(BIN)/python -m pytest --numprocesses 2 --one-case \
		$(addprefix --ignore test/,gap/test_calibration.py estimation/test_population.py estimation/test_uncertainty.py) \
		$(addprefix test/,geometry model signals estimation gap)

lint: $(VENV)/.test-ready ## Set up, then run ruff and mypy
	$(BIN)/ruff check
	$(BIN)/mypy

docs: $(VENV)/.test-ready ## Set up, then write the tables of docs/pages/reference.md and the architecture's picture from the code
	$(BIN)/python docs/generators/tables.py
	$(BIN)/python docs/generators/architecture.py

pictures: $(VENV)/.run-ready ## Set up, then draw the moving picture of README.md, and run the notebook anew
	$(BIN)/python docs/generators/moving_picture.py
	$(BIN)/python docs/generators/notebook.py examples/identify.ipynb

site: $(SITE)/.ready ## Set up an environment of its own, then build the documentation into out/site
	NO_MKDOCS_2_WARNING=1 $(SITE)/bin/python -m mkdocs build --strict --config-file docs/mkdocs.yml

dist: $(VENV)/.test-ready ## Set up, then build sdist and wheel into out/dist, and try them
	rm -rf out/dist
	SOURCE_DATE_EPOCH=$$(git log -1 --format=%ct) $(BIN)/python -m build --no-isolation --outdir out/dist
	$(BIN)/python -m pytest test/test_distribution.py
	cd out/dist && sha256sum *

bench: $(VENV)/.bench-ready ## Set up, then reproduce the paper beside other methods, into out/bench
	$(BIN)/python -m benchmarks $(BENCH_ARGS)

colcon: $(VENV)/.test-ready ## Build and test as a ROS workspace does, into build/, install/ and log/
	$(BIN)/colcon build
	$(BIN)/colcon test
	$(BIN)/colcon test-result --verbose

clean: ## Remove environments, builds and caches
	rm -rf .venv .venv-* build install log out *.egg-info .pytest_cache .mypy_cache .ruff_cache .hypothesis
	find . -name __pycache__ -prune -exec rm -rf {} +

$(VENV)/.run-ready: requirements.txt constraints.txt setup.py setup.cfg
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "Python 3.11 or 3.12 is needed: make PYTHON=python3.12 ...")'
	$(PYTHON) -m venv $(VENV)
	$(PIP_INSTALL) --requirement requirements.txt
	rm -rf $(VENV)/lib/python*/site-packages/cmeel.prefix/include # Boost's headers, 0.2 GB: nothing is compiled with them
	$(PIP_INSTALL) --no-deps --no-build-isolation --editable .
	@touch $@

$(VENV)/.test-ready: $(VENV)/.run-ready requirements-test.txt
	$(PIP_INSTALL) --requirement requirements-test.txt
	@touch $@

$(SITE)/.ready: requirements-docs.txt
	$(PYTHON) -m venv $(SITE)
	$(SITE)/bin/python -m pip install -qq --disable-pip-version-check --requirement requirements-docs.txt
	@touch $@

$(VENV)/.bench-ready: $(VENV)/.run-ready requirements-bench.txt
	$(PIP_INSTALL) --requirement requirements-bench.txt
	@touch $@
