# Each target works from a fresh clone: it creates the environment first.
.DEFAULT_GOAL := help
PYTHON ?= python3
EXTRAS ?= all
VENV   := .venv
BIN    := $(VENV)/bin
export PIP_DISABLE_PIP_VERSION_CHECK := 1
export PYTHON
unexport PYTHONDONTWRITEBYTECODE  # each run starts processes; without bytecode every one compiles evalkit again

.PHONY: help install report report-quick system test test-all check check-style check-mypy check-pyright check-imports bench faults soak mutation coverage core-coverage planted paper paper-quick metric-validation calibrate map-fit tune schema docs fuzz clean distclean

help:  ## print this list
	@awk -F':.*## ' '/^[a-z-]+:.*## /{printf "  make %-17s %s\n", $$1, $$2}' $(MAKEFILE_LIST)

install: $(VENV)/evalkit  ## install evalkit into .venv, with Open3D and KISS-ICP (EXTRAS= omits them)

report: $(VENV)/evalkit system  ## run the full comparison: reports/build/default/index.html
	$(BIN)/evalkit datasets fetch --for reports/default.toml
	$(BIN)/evalkit compare reports/default.toml --resume --out reports/build/default

report-quick: $(VENV)/evalkit system  ## run a small comparison in under 60 s: reports/build/quick/index.html
	$(BIN)/evalkit datasets fetch --for reports/quick.toml
	$(BIN)/evalkit compare reports/quick.toml --resume --out reports/build/quick

system:  ## install the system libraries that Open3D needs, where that is possible
	@.ci/system-packages open3d

# Two more than there are cores, because some tests wait for a limit or a browser; each computes with one thread.
CORES = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
WORKERS ?= $$($(PYTHON) -c 'import os; print(min(2 + ($(CORES)), 6))')
test test-all: export OPENBLAS_NUM_THREADS := 1
test: $(VENV)/test  ## run the tests, and print the ten slowest
	@.ci/system-packages open3d browser
	$(BIN)/pytest -n $(WORKERS) --dist loadfile --no-loadscope-reorder --durations=10

test-all: $(VENV)/test  ## run the tests with every case of the exhaustive ones, and all commands of the documentation
	@.ci/system-packages open3d browser
	EVALKIT_DOCUMENTATION_LONG=1 $(BIN)/pytest -n $(WORKERS) --dist loadfile --no-loadscope-reorder --durations=30 -m ''

check: check-style check-mypy check-pyright check-imports  ## check style, formatting, types and import layers

check-style: $(VENV)/dev
	$(BIN)/ruff check
	$(BIN)/ruff format --check

check-mypy: $(VENV)/dev
	$(BIN)/mypy

check-pyright: $(VENV)/dev
	$(BIN)/pyright

check-imports: $(VENV)/dev
	$(BIN)/lint-imports --no-cache

bench: $(VENV)/evalkit  ## run every benchmark and print each figure beside its aim
	$(BIN)/python tests/bench/run.py

faults: $(VENV)/test  ## inject faults of back ends and check how each run ends
	$(BIN)/python tests/bench/faults.py

soak: $(VENV)/test  ## run 2,000 short runs under random kills, full disks and damage: lost, wrong, left
	$(BIN)/python tests/bench/soak.py

mutation: $(VENV)/test  ## change the code at random and count how often the tests notice: survivors, score
	$(BIN)/python tests/mutation/run.py

coverage: $(VENV)/test  ## count the lines and branches of the Python code that all tests reach, beside the aims
	@.ci/system-packages open3d browser
	$(BIN)/python -m pip install --quiet 'coverage>=7.10'
	$(BIN)/python tests/mutation/python_coverage.py -- -m ''

core-coverage:  ## count the lines and branches of the C core that its own tests reach (needs cmake, gcc and gcov)
	$(PYTHON) tests/mutation/core_coverage.py

planted: $(VENV)/test  ## validate five implementations with planted faults: found, named, time (continues)
	$(BIN)/python tests/planted/run.py

fuzz: $(VENV)/test  ## fuzz every reader for a minute (options: tests/fuzz/run.py --help)
	$(BIN)/python tests/fuzz/run.py --seconds 60

paper: $(VENV)/evalkit  ## reproduce the paper: reports/build/paper/index.html
	$(BIN)/python -m evalkit_paper reports/paper.toml

paper-quick: $(VENV)/evalkit  ## reproduce part of the paper in under 2 min: reports/build/paper-quick/index.html
	$(BIN)/python -m evalkit_paper reports/paper-quick.toml

metric-validation: $(VENV)/evalkit  ## measure how map metrics follow the true error: reports/build/metrics/index.html
	$(BIN)/python -m evalkit.commands.metric_validation validate --world lab --world office --world room
	$(BIN)/python -m evalkit.commands.metric_validation selftest --world lab

calibrate: $(VENV)/evalkit  ## measure how honest intervals and verdicts are: reports/build/calibration/index.html
	$(BIN)/python -m evalkit.commands.calibration reports/calibration.toml

map-fit: $(VENV)/evalkit  ## learn how likely a position in a known map is wrong by its fit: reports/build/map-fit/map-fit.md
	$(BIN)/python -m evalkit.commands.map_fit reports/map-fit.toml

tune: $(VENV)/evalkit  ## tune back ends with equal budgets: reports/build/tune/index.html
	$(BIN)/evalkit tune reports/tune.toml --out reports/build/tune

schema: $(VENV)/evalkit  ## write the JSON Schemas that the files in reports/ name, for editors: reports/build/*.schema.json
	for kind in experiment study tuning; do $(BIN)/evalkit schema $$kind --out reports/build/$$kind.schema.json; done

docs: $(VENV)/docs  ## build the documentation: reports/build/site/index.html
	PYTHONPATH=docs $(BIN)/python -m evalkit_docs.build

clean:  ## remove all results
	rm -rf reports/build

distclean: clean  ## remove the environment as well
	rm -rf $(VENV)

$(VENV)/python: $(MAKEFILE_LIST)
	@.ci/system-packages python
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
	  { echo "evalkit needs Python 3.11 or newer; $(PYTHON) is $$($(PYTHON) -V 2>&1). Try: make PYTHON=python3.12 $(MAKECMDGOALS)"; exit 1; }
	@test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	@touch $@

comma := ,
$(VENV)/evalkit: pyproject.toml | $(VENV)/python
	$(BIN)/python -m pip install --quiet --editable '.$(if $(EXTRAS),[$(EXTRAS)])'
	@touch $@

$(VENV)/test: pyproject.toml | $(VENV)/python
	$(BIN)/python -m pip install --quiet --editable '.[test$(if $(EXTRAS),$(comma)$(EXTRAS))]'
	@touch $(VENV)/evalkit $@

$(VENV)/docs: pyproject.toml | $(VENV)/python
	$(BIN)/python -m pip install --quiet --editable '.[docs$(if $(EXTRAS),$(comma)$(EXTRAS))]'
	@touch $(VENV)/evalkit $@

$(VENV)/dev: pyproject.toml | $(VENV)/python
	$(BIN)/python -m pip install --quiet --editable '.[dev$(if $(EXTRAS),$(comma)$(EXTRAS))]'
	@touch $(VENV)/evalkit $(VENV)/test $(VENV)/docs $@
