# mother_rover without ROS on the machine: every target makes what it needs in $(VENV), once, from PyPI.
# Users of a sourced ROS 2 Jazzy build with colcon and need none of this.

VENV ?= .venv
RUNS ?= 20
SEED ?= 1
HOURS ?= 1
PYTEST ?=
MINUTES ?= 10

BIN := $(VENV)/bin
RUN := $(BIN)/python -m

# A sourced ROS 2, or the ROS wheels of another environment, must not leak into ours.
unexport PYTHONPATH PYTHONHOME PYTHONDONTWRITEBYTECODE VIRTUAL_ENV LD_LIBRARY_PATH _ROS_WHEELS_BOOTSTRAP_COMPLETE
unexport RMW_IMPLEMENTATION COLCON_PREFIX_PATH CMAKE_PREFIX_PATH
# ament_index finds the package in the environment's root; the wheels do not set this.
export AMENT_PREFIX_PATH := $(abspath $(VENV))
# Other machines on the network stay out of demo, tests and benches.
export ROS_AUTOMATIC_DISCOVERY_RANGE ?= LOCALHOST

.NOTPARALLEL:
.DEFAULT_GOAL := help
.PHONY: help demo test quick coverage fuzz bench verify study lint types contract docs constraints \
	environment clean

help:  ## show this list
	@echo "make TARGET        (each does its own set-up in $(VENV); needs Python 3.11 or 3.12, and PyPI once)"
	@sed -n 's/^\([a-z]*\):.*## /  \1\t/p' $(MAKEFILE_LIST) | expand -t 15

demo: $(VENV)/.ready-run  ## a mission down the Marius Hills Hole and back, reported into out/demo
	@$(BIN)/mother_rover demo

test: $(VENV)/.ready-test  ## unit, physics, node and process tests (PYTEST="-k winch" selects)
	@$(BIN)/mother_rover compile
	@$(BIN)/python tools/run_tests.py $(PYTEST)

quick: $(VENV)/.ready-test  ## the tests without simulation, processes, ROS and fuzzing
	@$(BIN)/python tools/run_tests.py --one-process -q -m "not slow and not ros and not fuzz" \
		test/msg_schemas test/rover_cli test/rover_control test/tether_winch \
		test/test_architecture.py test/test_contributing.py \
		--ignore-glob="*/test_jump*.py" --ignore-glob="*/test_command_records.py" \
		--ignore-glob="*/test_winch*.py" --ignore-glob="*/test_silent*.py" \
		--ignore-glob="*/test_descent*.py" --ignore-glob="*_flight*.py" \
		--ignore-glob="*/test_swing*.py" --ignore-glob="*/test_mission_restart.py" $(PYTEST)

coverage: $(VENV)/.ready-test-dev  ## the share of lines that the tests in one process run, into out/coverage
	@$(BIN)/python tools/run_tests.py --one-process -q --cov --cov-report=term \
		--cov-report=html:out/coverage $(PYTEST)

fuzz: $(VENV)/.ready-test-fuzz  ## hostile input by coverage; what breaks is kept in test/corpus (MINUTES=10)
	@$(BIN)/python tools/fuzz.py --minutes $(MINUTES)

verify: $(VENV)/.ready-test-bench  ## the verification matrix into out/verification.json (RUNS=20 SEED=1 HOURS=1)
	@$(BIN)/mother_rover compile
	@$(BIN)/mother_rover verify --runs $(RUNS) --seed $(SEED) --hours $(HOURS)

study: $(VENV)/.ready-run  ## the paper's study of the tethered jump, figures 11 to 16, into out/study
	@$(BIN)/mother_rover study all

bench: $(VENV)/.ready-bench  ## speed and error side by side with Exudyn, into out/bench.json
	@$(BIN)/mother_rover bench

lint: $(VENV)/.ready-test-dev  ## ruff, the glossary's words, the subjects of commits
	@$(RUN) ruff check .
	@$(RUN) ruff format --check --quiet .
	@$(BIN)/python tools/check_words.py
	@$(BIN)/python tools/check_commits.py

types: $(VENV)/.ready-test-dev  ## mypy, strict
	@$(RUN) mypy

contract: $(VENV)/.ready-run  ## write docs/contract.md anew from the contract
	@$(BIN)/mother_rover contract

docs: $(VENV)/.ready-docs  ## the documentation as a site, into out/docs
	@$(RUN) sphinx -q -W --keep-going -b html -c docs . out/docs
	@echo "Written: out/docs/docs/index.html"

constraints: $(VENV)/.ready-test-dev  ## the newest versions of all that is installed, into constraints/
	@$(BIN)/python tools/write_constraints.py

environment: $(VENV)/.ready-test-dev  ## only the set-up, with everything for development
	@$(BIN)/mother_rover compile
	@echo "$(VENV) is ready"

clean:  ## remove environment, builds and caches; results in out/ stay
	rm -rf $(VENV) build install log dist *.egg-info .mypy_cache .pytest_cache .ruff_cache .hypothesis
	find . -name __pycache__ -type d -prune -exec rm -rf {} +

# An environment is made for one place and one Python: it is looked at again when the tree has moved,
# or when PYTHON=... on the command line asks for another.
LOOK_AGAIN := $(if $(filter command line,$(origin PYTHON)),look-again)
ifneq ($(shell cat $(VENV)/place 2>/dev/null),$(CURDIR))
LOOK_AGAIN := look-again
endif
.PHONY: look-again
look-again:

# .ready-run, .ready-test, .ready-test-dev ...: the environment holds these extras. Refreshed when what
# the installation copies or resolves has changed; sources need no refresh, the install is editable.
INSTALLED := setup.py setup.cfg pyproject.toml package.xml tools/set_up.sh \
	constraints/make.txt $(wildcard scripts/* launch/* config/* resource/*)
extras = $(filter-out run,$(subst -, ,$(patsubst .ready-%,%,$(notdir $@))))

$(VENV)/.ready-%: $(INSTALLED) $(LOOK_AGAIN)
	@tools/set_up.sh $(VENV) $(extras)
	@touch $@ $(VENV)/.ready-run $(if $(filter test,$(extras)),$(VENV)/.ready-test)
