PYTHON ?= python3
BIN := .venv/bin

.PHONY: install tools run test check docs clean

run: install  ## Generate flights, score the estimators, fly them through four scenarios, write the report
	$(BIN)/quadsim demo --out reports/demo

test: tools  ## The whole suite
	OMP_NUM_THREADS=1 $(BIN)/pytest -n auto

check: tools  ## Linter, formatter, type checker, import contract, pages that were edited since they were made, words
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/basedpyright
	$(BIN)/lint-imports
	$(BIN)/python docs/pages.py --check
	$(BIN)/python docs/words.py

install: .venv/installed  ## What flies, compares and reports

tools: .venv/tools  ## The same, the trainer, and what tests and pages need

.venv/installed: pyproject.toml constraints.txt
	$(PYTHON) -c 'import sys; sys.exit("quadsim needs Python 3.11 or newer: make PYTHON=python3.11 ...") if sys.version_info < (3, 11) else None'
	$(PYTHON) -m venv .venv
	$(BIN)/pip install --quiet --disable-pip-version-check -c constraints.txt -e .
	touch $@

.venv/tools: .venv/installed
	$(BIN)/pip install --quiet --disable-pip-version-check -c constraints.txt -e ".[dev]"
	touch $@

docs: tools  ## The site, into reports/site; a broken link is an error
	$(BIN)/mkdocs build --strict --quiet

clean:
	rm -rf .venv reports
