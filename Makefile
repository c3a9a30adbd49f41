# Everything happens in .venv, which tools/environment.sh makes and keeps up to date. Needed on the machine: x86-64
# Linux, Python 3.10 to 3.13, a C++ compiler, cmake, make. No ROS.

PYTHON ?= python3
BIN := .venv/bin
# A PYTHON that was asked for rules; otherwise an existing .venv keeps the Python it was made with.
ASKED_PYTHON := $(if $(filter command environment override,$(firstword $(origin PYTHON))),$(PYTHON))

# A sourced ROS installation must not mix with the one in .venv.
export AMENT_PREFIX_PATH := $(CURDIR)/.venv
unexport PYTHONPATH PYTHONHOME CMAKE_PREFIX_PATH COLCON_PREFIX_PATH RMW_IMPLEMENTATION
ifneq ($(ROS_DISTRO)$(_ROS_WHEELS_BOOTSTRAP_COMPLETE),)
unexport LD_LIBRARY_PATH ROS_DISTRO _ROS_WHEELS_BOOTSTRAP_COMPLETE
endif

.PHONY: help run test test-reproduction test-pages lint bench fuzz env lock clean

help:
	@echo 'make run     run the star test on the Tripod: record it, evaluate it, draw it'
	@echo 'make test    run the tests'
	@echo 'make test-reproduction   run every experiment and judge every claim of the thesis'
	@echo 'make test-pages   load reports in headless Chromium, which must be installed'
	@echo 'make lint    check style, types and who imports whom'
	@echo 'make bench   measure speed and memory'
	@echo 'make fuzz    read a million random and broken part programs (COUNT=1000 for fewer, SEED=2 for others),'
	@echo '             plan two thousand random motions (MOTIONS=100)'
	@echo 'make env     only make .venv, or bring it up to date (the others do that first)'
	@echo 'make lock    resolve requirements.in anew into requirements.lock'
	@echo 'make clean   remove .venv and caches; bags stay'
	@echo
	@echo 'PYTHON=python3.12 behind any of them chooses the interpreter of .venv (3.10 to 3.13; without it: python3).'

env:
	@tools/environment.sh $(ASKED_PYTHON)

run: env
	@tools/star_test.sh

test: env
	@$(BIN)/pytest test --ignore=test/peer --ignore=test/pages --ignore=test/reproduction

# What `pkm_cnc reproduce` says, all of it: two minutes on two idle cores.
test-reproduction: env
	@$(BIN)/pytest test/reproduction

test-pages: env
	@$(BIN)/pytest test/pages

lint: env
	@echo '== ruff'
	@$(BIN)/ruff check
	@$(BIN)/ruff format --check
	@echo '== mypy'
	@$(BIN)/mypy
	@echo '== import-linter'
	@$(BIN)/lint-imports

bench: env
	@$(BIN)/python tools/bench.py

fuzz: env
	@$(BIN)/python tools/fuzz.py --count $(or $(COUNT),1000000) --seed $(or $(SEED),1)
	@$(BIN)/python tools/fuzz_motion.py --count $(or $(MOTIONS),2000) --seed $(or $(SEED),1)

lock:
	@tools/lock.sh

clean:
	rm -rf .venv .pytest_cache .mypy_cache .ruff_cache .import_linter_cache .hypothesis build install log
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
