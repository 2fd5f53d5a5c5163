PYTHON ?= python3
BIN := .venv/bin
OUT ?= demo

.PHONY: demo test setup check format clean

demo: setup
	$(BIN)/legsim run --preset demo --out $(OUT)

test: setup check
	$(BIN)/python -m pytest -n 2 --dist worksteal

setup: .venv/.installed

.venv/.installed: pyproject.toml
	test -x $(BIN)/python || $(PYTHON) -m venv .venv
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[dev]'
	touch $@

check: setup
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/pyright

format: setup
	$(BIN)/ruff format .
	$(BIN)/ruff check --fix .

clean:
	rm -rf .venv build dist $(OUT)
