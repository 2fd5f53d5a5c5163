PYTHON ?= python3
BIN := .venv/bin
OUT ?= demo

.PHONY: demo test quick setup check format clean

demo: setup
	$(BIN)/legsim run --preset demo --out $(OUT)

test: setup check
	$(BIN)/python -m pytest -n 2 --dist worksteal

# without whole runs and clusters: under two minutes on two cores
quick: setup
	$(BIN)/python -m pytest -n 2 --dist worksteal -m "not end_to_end"

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
