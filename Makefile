PYTHON ?= python3
BIN := .venv/bin
OUT ?= demo
DEVICE ?= gpu

# where mkdocs is: another environment than the tests' will do
DOCS ?= .venv

.PHONY: demo test quick gpu peers docs setup check format clean

demo: setup
	$(BIN)/legsim run --preset demo --out $(OUT)

test: setup check
	$(BIN)/python -m pytest -n 2 --dist worksteal

# without whole runs and clusters: under two minutes on two cores
quick: setup
	$(BIN)/python -m pytest -n 2 --dist worksteal -m "not end_to_end"

# beside OpenSim, RTK, ASTRA and GTSAM, as far as they are installed (pip install -e '.[peer]'); a table
peers: setup
	$(BIN)/python -m pytest -m peer

# the site with guides and reference, in build/site
docs: $(DOCS)/.docs-installed
	NO_MKDOCS_2_WARNING=1 $(DOCS)/bin/mkdocs build --strict

$(DOCS)/.docs-installed: pyproject.toml
	test -x $(DOCS)/bin/python || $(PYTHON) -m venv $(DOCS)
	$(DOCS)/bin/python -m pip install --quiet --disable-pip-version-check --editable '.[docs]'
	touch $@

# kernel tests and benchmarks on a GPU, or on DEVICE: part of a device's name
gpu: setup
	$(BIN)/python -m tools.benchmarks device $(DEVICE)
	LEGSIM_DEVICE="$(DEVICE)" $(BIN)/python -m pytest -m "not end_to_end" tests/opencl tests/phantom \
		tests/scan tests/deformation tests/reconstruction tests/correction tests/simulation
	LEGSIM_DEVICE="$(DEVICE)" $(BIN)/python -m tools.benchmarks project
	LEGSIM_DEVICE="$(DEVICE)" $(BIN)/python -m tools.benchmarks fdk
	LEGSIM_DEVICE="$(DEVICE)" $(BIN)/python -m tools.benchmarks fdk-rounding --slices 4

setup: .venv/.installed

.venv/.installed: pyproject.toml
	test -x $(BIN)/python || $(PYTHON) -m venv .venv
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[dev]'
	touch $@

check: setup
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/codespell
	$(BIN)/pyright

format: setup
	$(BIN)/ruff format .
	$(BIN)/ruff check --fix .

clean:
	rm -rf .venv build dist $(OUT)
