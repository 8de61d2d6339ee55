# Everything lives in .venv: its parts are made when they are missing or when what they are made of has changed.
# A file in .venv/.done stands for a part that was finished; a half-made part has none and is made again.

PYTHON ?= python3
DONE := .venv/.done

SHELL := /bin/bash
.SHELLFLAGS := -euo pipefail -c
.ONESHELL:
.NOTPARALLEL:
.PHONY: help demo test lint docs bench fuzz soak pictures

# What another environment that is active in the shell would mix into ours: Python's, and ROS's.
unexport PYTHONPATH PYTHONHOME VIRTUAL_ENV PIP_USER PIP_TARGET PIP_PREFIX
ifneq ($(AMENT_PREFIX_PATH)$(_ROS_WHEELS_BOOTSTRAP_COMPLETE),)
unexport AMENT_PREFIX_PATH CMAKE_PREFIX_PATH COLCON_PREFIX_PATH LD_LIBRARY_PATH RMW_IMPLEMENTATION
unexport _ROS_WHEELS_BOOTSTRAP_COMPLETE
endif

help:
	@cat <<- END
	make demo   set up, then find what the model of a simulated experiment misses
	make test   set up, then run the tests
	make lint   set up, then check style and types
	make docs   set up, then build the documentation: docs/_build/html/index.html
	make bench  set up, then measure the speed; it takes some minutes
	make fuzz   set up, then read damaged files; FUZZ_EXAMPLES=2000 of each kind take half an hour
	make soak   set up, then run all nodes for an hour and kill them at random; SOAK_MINUTES=60
	make pictures  set up, then make the pictures of the pages anew; needs Chromium
	The first run sets up .venv and takes some minutes. PYTHON=python3.12 chooses the Python of a new .venv.
	END

demo: $(DONE)/compiled
	@.venv/bin/sugiyama demo

# No test waits for the compiler: what has been edited is compiled before. Journeys, which take longest, come before unit
# tests, so that both processes end at about the same time.
test: $(DONE)/compiled $(DONE)/tools
	@.venv/bin/python -m sugiyama_ros.compile
	.venv/bin/python -m pytest -n 2 --dist loadfile --no-loadscope-reorder test

bench: $(DONE)/compiled $(DONE)/tools
	@.venv/bin/python -m benchmarks.speed

# FUZZ_EXAMPLES: damaged files of each kind. What breaks a reader stays in .hypothesis/ and is tried first the next time.
FUZZ_EXAMPLES ?= 2000

fuzz: $(DONE)/compiled $(DONE)/tools
	@FUZZ_EXAMPLES=$(FUZZ_EXAMPLES) .venv/bin/python -m pytest --timeout 7200 test/fuzz test/property

# SOAK_MINUTES: the first half is quiet, in the second half nodes are killed.
SOAK_MINUTES ?= 60

soak: $(DONE)/compiled $(DONE)/tools
	@.venv/bin/python test/soak/soak.py --minutes $(SOAK_MINUTES)

pictures: $(DONE)/compiled $(DONE)/tools
	@.venv/bin/python docs/pictures.py

lint: $(DONE)/package $(DONE)/tools
	@.venv/bin/ruff check .
	.venv/bin/ruff format --check .
	.venv/bin/mypy

# -W: a warning is an error. Notebooks are run again when they have changed, or after `rm -r docs/_build`.
docs: $(DONE)/package $(DONE)/docs
	@.venv/bin/python -m sphinx -W --keep-going -b html docs docs/_build/html

# Installs with pip and shows every twentieth package or compiled file. $(call pip,what,arguments)
define pip
log=.venv/$(strip $(1)).log
if ! .venv/bin/python -m pip install --progress-bar off $(2) 2>&1 | tee $$log \
	| sed -un 's/^Collecting \([^ ]*\).*/\1/p; s/^ *\(\[[0-9]*\/[0-9]*\]\) Building .*/\1/p' | sed -un '1~20s/^/    /p'
then
	tail -n 40 $$log
	echo "error: $(strip $(1)) failed, see above and $$log; after mending the cause, run make again" >&2
	exit 1
fi
touch $@
endef

define CHECK
import os, platform, shutil, sys, sysconfig
def need(condition, text):
    if not condition:
        sys.exit("error: " + text)
found = "Python %d.%d" % sys.version_info[:2]
need((3, 10) <= sys.version_info[:2] <= (3, 13), found + " found, need 3.10-3.13; choose one with PYTHON=python3.12")
need((sys.platform, platform.machine()) == ("linux", "x86_64"),
     "ROS comes as wheels for x86-64 Linux only; elsewhere build in a ROS 2 workspace, see README.md")
try:
    import ensurepip, venv
except ImportError:
    sys.exit("error: %s cannot make virtual environments; sudo apt install python3-venv" % found)
need(any(shutil.which(name) for name in (os.environ.get("CXX", "c++"), "c++", "g++", "clang++")),
     "no C++ compiler; sudo apt install g++")
header = os.path.join(sysconfig.get_path("include"), "Python.h")
need(os.path.exists(header), header + " is missing; sudo apt install python3-dev")
endef
export CHECK

# A .venv that was made elsewhere and moved or copied here does not work: its programs name the old place.
ifneq ($(shell cat $(DONE)/venv 2> /dev/null),$(CURDIR))
.PHONY: $(DONE)/venv
endif

$(DONE)/venv:
	@command -v "$(PYTHON)" > /dev/null || { echo "error: $(PYTHON) not found; choose Python 3.10-3.13 with PYTHON=" >&2; exit 1; }
	"$(PYTHON)" -c "$$CHECK"
	echo "Setting up .venv with $$("$(PYTHON)" --version), once; it takes some minutes and 1 GB."
	rm -rf .venv
	"$(PYTHON)" -m venv .venv
	mkdir $(DONE)
	echo "$(CURDIR)" > $@

$(DONE)/requirements: $(DONE)/venv requirements.txt
	@echo "Installing what it needs, ROS 2 among it: $$(grep -c == requirements.txt) packages, 1-3 minutes"
	$(call pip, requirements, -r requirements.txt)

$(DONE)/messages: $(DONE)/requirements $(wildcard msg_defs/* msg_defs/*/*)
	@echo "Compiling the messages: 112 files, most of them the code by which Python and Fast DDS read and write; half a minute"
	$(call pip, messages, --no-deps --no-build-isolation --force-reinstall -v ./msg_defs)

$(DONE)/package: $(DONE)/messages setup.py setup.cfg package.xml $(wildcard resource/* launch launch/*.py config config/*.yaml)
	@echo "Installing sugiyama_ros: some seconds"
	$(call pip, package, --no-deps --no-build-isolation --editable .)

# Once, and not again whenever a file is edited: what has changed is compiled when it is called.
$(DONE)/compiled: $(DONE)/package
	@echo "Compiling the model and the filters: a minute"
	.venv/bin/python -m sugiyama_ros.compile
	touch $@

$(DONE)/tools: $(DONE)/requirements requirements-dev.txt
	@echo "Installing what tests and lint need: $$(grep -c == requirements-dev.txt) packages, half a minute"
	$(call pip, tools, -r requirements-dev.txt)

$(DONE)/docs: $(DONE)/requirements requirements-docs.txt
	@echo "Installing what the documentation needs: $$(grep -c == requirements-docs.txt) packages, half a minute"
	$(call pip, docs, -r requirements-docs.txt)
