# make demo: the whole job on the example campaign. make test: lint, layers, types, tests; make study: the slow tests, too.
# make docs: the site. All set themselves up.
PYTHON ?= python3
LOWEST_PYTHON ?= python3.10
BIN := .venv/bin

.PHONY: demo test test-lowest bench study interop docs docs-test release clean

demo: .venv/ready
	$(BIN)/vpp demo -o demo

test: .venv/ready
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/lint-imports
	$(BIN)/mypy
	$(BIN)/pytest -n 2 --dist loadgroup

test-lowest: .venv/ready # with the lowest Python and versions that pyproject.toml allows
	$(BIN)/python -m tests.lowest > .venv/lowest.txt
	test -d .venv/lowest || $(LOWEST_PYTHON) -m venv .venv/lowest
	.venv/lowest/bin/python -m pip install --quiet --disable-pip-version-check --constraint .venv/lowest.txt --editable '.[test,import,watch]'
	.venv/lowest/bin/pytest -n 2 --dist loadgroup
	$(BIN)/python -m tests.lowest --passed

bench: .venv/ready
	$(BIN)/python -m tests.benchmarks
	$(BIN)/python -m tests.benchmarks.native

study: .venv/ready
	$(BIN)/python -m tests.studies identification --workers 2
	$(BIN)/pytest -n 2 --dist loadgroup -m slow

interop: .venv/ready
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --constraint constraints.txt --editable '.[interop]'
	test -d .venv/cofmupy || $(PYTHON) -m venv .venv/cofmupy # it pins an FMPy of its own
	.venv/cofmupy/bin/python -m pip install --quiet --disable-pip-version-check cofmupy
	$(BIN)/python -m tests.interop

docs: .venv/docs
	NO_MKDOCS_2_WARNING=1 $(BIN)/python -m mkdocs build --quiet -f docs/site/mkdocs.yml # warnings are errors, links are checked
	@echo "build/site/index.html; with search: $(BIN)/python -m http.server -d build/site"

docs-test: .venv/docs
	$(BIN)/python -m tests.site

release: .venv/ready
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --constraint constraints.txt --editable '.[release]'
	$(BIN)/python -m tests.release

.venv/docs: .venv/ready
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --constraint constraints.txt --editable '.[docs]'
	touch $@

.venv/ready: pyproject.toml constraints.txt
	$(PYTHON) -m venv .venv
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --constraint constraints.txt --editable '.[test,import,watch]'
	touch $@

clean:
	rm -rf .venv demo out build
