# Needs python3 (3.11 or newer, with venv), a C++17 compiler and make; everything else is installed into .venv.

PYTHON ?= python3
DEMO_SECONDS ?= 10

VENV := .venv
PIP := $(VENV)/bin/pip install --quiet --constraint constraints.txt
# Installed editable: Python changes are live, and a Python started in this folder finds the native module too.
BUILT_FROM := pyproject.toml constraints.txt $(shell find native -type f -not -path '*/__pycache__/*')
MESSAGES := $(shell find msg_defs -type f -not -path '*/__pycache__/*')

.PHONY: demo test test-slow lint format clean

demo: $(VENV)/installed-demo
	$(VENV)/bin/physkin demo --seconds $(DEMO_SECONDS) --output demo.png

# What starts ROS nodes and measures times has the machine to itself; one thread each for the others.
test: $(VENV)/installed-test
	OMP_NUM_THREADS=1 $(VENV)/bin/pytest -m "not slow" --numprocesses 2 --dist loadfile --ignore tests/ros
	$(VENV)/bin/pytest -m "not slow" tests/ros

test-slow: $(VENV)/installed-test
	$(VENV)/bin/pytest -m slow

lint: $(VENV)/installed-lint
	$(VENV)/bin/ruff check .
	$(VENV)/bin/ruff format --check .

format: $(VENV)/installed-lint
	$(VENV)/bin/ruff check --fix .
	$(VENV)/bin/ruff format .

clean:
	rm -rf $(VENV) build dist demo.png
	find . -name __pycache__ -type d -not -path './$(VENV)/*' -prune -exec rm -r {} +

$(VENV)/bin/python:
	$(PYTHON) -m venv $(VENV)
	$(PIP) --upgrade pip

$(VENV)/installed-demo: $(BUILT_FROM) | $(VENV)/bin/python
	$(PIP) --editable ".[ros,view]"
	touch $@

# torch goes first and alone, so that the build the user's pip is set up for (CPU or CUDA) is the one the rest meets.
$(VENV)/installed-test: $(BUILT_FROM) $(MESSAGES) | $(VENV)/bin/python
	$(PIP) torch
	$(PIP) --editable ".[ros,replay,training,view,test]"
	$(VENV)/bin/python msg_defs/wheel/build.py --install
	touch $@ $(VENV)/installed-demo $(VENV)/installed-lint

$(VENV)/installed-lint: | $(VENV)/bin/python
	$(PIP) ruff
	touch $@
