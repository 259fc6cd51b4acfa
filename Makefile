# make demo: the whole job on the example campaign. make test: lint, layers, types, tests. Both set themselves up.
PYTHON ?= python3
BIN := .venv/bin

.PHONY: demo test bench study interop clean

demo: .venv/ready
	$(BIN)/vpp demo -o demo

test: .venv/ready
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/lint-imports
	$(BIN)/mypy
	$(BIN)/pytest -n 2 --dist loadgroup

bench: .venv/ready
	$(BIN)/python -m tests.benchmarks
	$(BIN)/python -m tests.benchmarks.native

study: .venv/ready
	$(BIN)/python -m tests.studies identification --workers 2

interop: .venv/ready
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --constraint constraints.txt --editable '.[interop]'
	test -d .venv/cofmupy || $(PYTHON) -m venv .venv/cofmupy # it pins an FMPy of its own
	.venv/cofmupy/bin/python -m pip install --quiet --disable-pip-version-check cofmupy
	$(BIN)/python -m tests.interop

.venv/ready: pyproject.toml constraints.txt
	$(PYTHON) -m venv .venv
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --constraint constraints.txt --editable '.[test,import,watch]'
	touch $@

clean:
	rm -rf .venv demo out
