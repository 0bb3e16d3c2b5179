# `make demo`, `make test`, `make gate`. Each does all the set-up it needs.
PYTHON ?= $(shell command -v python3.11 || command -v python3)
# the work has threads of its own
export OPENBLAS_NUM_THREADS := 1
VENV := .venv
RUN := $(VENV)/bin
LAB := $(VENV)/.lab
DEV := $(VENV)/.dev
CLIENTS := .clients/.done
# tests that start processes of their own, and need no kernels: they run while these are compiled
LAUNCHERS := tests/experiments/test_sweep.py tests/experiments/test_study.py
# Python compiles what it imports; pip would all of it, half a minute
INSTALL = $(RUN)/python -m pip install --disable-pip-version-check --progress-bar off --no-compile \
          --constraint constraints.txt

.PHONY: demo benchmark test test-all test-clients fuzz kills gate baseline docs check kernels setup clean $(LAUNCHERS)
.DEFAULT_GOAL := demo

demo: $(LAB)  ## shoot the floor exercise, reconstruct it, score it: outputs/demo/report.html
	$(RUN)/python -m experiments.run experiment=floor_exercise seed=0 hydra.run.dir=outputs/demo

benchmark: $(LAB)  ## shoot the mini split, let all methods of this tree answer, and make the board of them: an hour
	$(RUN)/python -m experiments.benchmark make split=mini
	$(RUN)/python -m experiments.benchmark score split=mini
	$(RUN)/python -m experiments.benchmark board split=mini

test: $(LAB)  ## everything that has to hold
	$(MAKE) --no-print-directory --jobs 2 kernels check $(LAUNCHERS)
	$(RUN)/python -m pytest -n 2 --dist loadgroup $(LAUNCHERS:%=--ignore=%)

fuzz: $(DEV)  ## 10,000 damaged files: each a result or one line; 20 minutes on a free machine
	PZCAP_FUZZ=10000 $(RUN)/python -m pytest tests/fuzz

kills: $(DEV)  ## 100 kills of shoots, runs and sweeps at random moments: nothing lost, nobody left; half an hour
	$(RUN)/python -m tests.fuzz.kills 100

test-all: check kernels  ## and the tests that take minutes each
	$(RUN)/python -m pytest -n 2 --dist loadgroup -m "heavy or not heavy"

gate: $(LAB)  ## is any figure worse than the committed baseline? two or three minutes
	$(RUN)/python -m experiments.gate

baseline: $(LAB)  ## make what is reached now the baseline, on purpose
	$(RUN)/python -m experiments.gate --renew

docs: $(DEV)  ## the pages of docs/ as a site: outputs/docs/index.html
	$(RUN)/python -m sphinx -q -n -W -b html docs outputs/docs

test-clients: $(CLIENTS)  ## the programs that we write for read what we write: three gigabytes of them
	$(RUN)/python -m pytest tests/clients

check: $(DEV)  ## style, types, and the arrows between the rooms
	$(RUN)/ruff check .
	$(RUN)/ruff format --check .
	$(RUN)/mypy
	$(RUN)/lint-imports

kernels: $(LAB)  # compiled once, while the other core installs and checks
	$(RUN)/python -m tests.compile_kernels

$(LAUNCHERS): $(DEV)  # each as soon as a core is free
	$(RUN)/python -m pytest $@

setup: $(DEV)  ## all that the README's commands need

$(LAB): pyproject.toml constraints.txt
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { echo "pzcap needs Python 3.11 or newer; say make PYTHON=/path/to/python3.11"; exit 1; }
	@sh .ci/system-libraries
	$(PYTHON) -m venv $(VENV)
	$(INSTALL) --editable '.[lab]'
	@touch $@

$(DEV): $(LAB)
	$(INSTALL) --editable '.[dev]'
	@touch $@

$(CLIENTS): $(DEV)  # each in an environment of its own: they want other versions of what pzcap is made of
	for client in aniposelib==0.8.0 pose2sim==0.10.49 bpy==5.0.1; do \
	  $(PYTHON) -m venv .clients/$${client%%=*} && \
	  .clients/$${client%%=*}/bin/python -m pip install --progress-bar off $$client || exit 1; done
	@touch $@

clean:  ## forget the environment and everything that was made
	rm -rf $(VENV) .clients outputs multirun
