# Everything a developer runs. 'make help' lists it; each target brings the environment up to date first.

PYTHON ?= python3
ARGS ?=
BIN := .venv/bin
# What running needs, and beside it what checking needs.
STAMP := .venv/.installed
TOOLS := .venv/.tools
DOCS := .venv/.docs
CODE := src tests $(wildcard benchmarks) $(wildcard evidence) $(wildcard docs/writers) $(wildcard tools) $(wildcard examples/*.py)

# Without bytecode, every process of the tests and each of its children would compile all sources.
unexport PYTHONDONTWRITEBYTECODE

.DEFAULT_GOAL := help
.PHONY: install tools run test test-long test-nightly mutation lint bench evidence pictures docs docs-serve docs-zip docs-publish docs-pages proto dist clean help

# 'make evidence NAME ...': the words after it are names, not targets.
ifeq (evidence,$(firstword $(MAKECMDGOALS)))
NAMES := $(wordlist 2,$(words $(MAKECMDGOALS)),$(MAKECMDGOALS))
ifneq ($(NAMES),)
.PHONY: $(NAMES)
$(NAMES): evidence
	@:
endif
endif

LINT = echo "== ruff check" && $(BIN)/ruff check $(CODE) && \
	echo "== ruff format" && $(BIN)/ruff format --check $(CODE) && \
	echo "== import-linter" && $(BIN)/lint-imports --no-logo
TYPES = echo "== mypy" && $(BIN)/mypy

install: $(STAMP)  ## make .venv and install qrsim with what running it needs, pinned (PYTHON=python3.12 chooses another Python)

# Both variables, because older and newer pip differ in which one pins what a build needs.
PIP := PIP_CONSTRAINT=constraints.txt PIP_BUILD_CONSTRAINT=constraints.txt \
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-compile --editable
# Compiled beforehand, as pip would do, but for the tests that packages bring: 33 MB that nobody imports.
COMPILE := $(BIN)/python -m compileall -q -j 0 -x '[/\\]tests?[/\\]' .venv/lib || true

$(STAMP): pyproject.toml constraints.txt
	@$(PYTHON) -c 'import sys; sys.exit(not (3, 11) <= sys.version_info[:2] <= (3, 14))' || { \
		echo "qrsim needs Python 3.11 to 3.14, and '$(PYTHON)' is not one: $$($(PYTHON) --version 2>&1)"; \
		echo "name another: make $(or $(firstword $(MAKECMDGOALS)),install) PYTHON=python3.12"; exit 1; }
	@$(PYTHON) -m venv .venv || { echo "no .venv could be made: on Debian or Ubuntu, install python3-venv"; exit 1; }
	$(PIP) .
	@$(COMPILE)
	@touch $@

tools: $(TOOLS)  ## the same, with every extra and what checks, benchmarks and evidence need

$(TOOLS): $(STAMP)
	$(PIP) '.[dev]'
	@$(COMPILE)
	@touch $@

run: $(STAMP)  ## run the default scenario (ARGS='...' is handed to 'qrsim run')
	@$(BIN)/qrsim run $(ARGS)

# Linters run during the tests, and their output follows that of the tests. mypy needs a core for a minute: long tests have it.
# Long tests wait for browsers, clients and clocks for a fifth of their time, so three processes use two cores.
test: $(TOOLS)  ## all checks, and all tests but the long ones
	@echo "== pytest"
	@{ $(LINT); } > .lint.log 2>&1 & linters=$$!; \
		$(BIN)/python -m pytest -n 2 --dist loadfile -m "not long and not nightly" $(ARGS); tests=$$?; \
		wait $$linters; lint=$$?; cat .lint.log; rm -f .lint.log; \
		[ $$lint -eq 0 ] && exit $$tests; exit $$lint

test-long: $(TOOLS)  ## mypy, and the long tests: real clients, browsers, small forms of the studies
	@echo "== pytest (long)"
	@{ $(TYPES); } > .types.log 2>&1 & types=$$!; \
		$(BIN)/python -m pytest -n 3 --dist loadfile -m "long and not nightly" $(ARGS); tests=$$?; \
		wait $$types; types=$$?; cat .types.log; rm -f .types.log; \
		[ $$types -eq 0 ] && exit $$tests; exit $$types

test-nightly: $(TOOLS)  ## tests of minutes each: random programs, fuzzing, other versions of Python and dependencies, mutation
	@echo "== pytest (nightly)"
	@$(BIN)/python -m pytest -n 2 --dist loadfile -m nightly $(ARGS)

mutation: $(TOOLS)  ## change models/ and control/, and print what no test notices: make mutation ARGS='--each 3 models/sensors/barometer.py'
	@$(BIN)/python -m tests.mutation $(ARGS)

lint: $(TOOLS)  ## formatting, lint, types, layers of imports
	@$(LINT) && $(TYPES)

bench: $(TOOLS)  ## run every benchmarks/*.py
	@set -e; for script in $(filter-out benchmarks/_%,$(sort $(wildcard benchmarks/*.py))); do \
		echo "== $$script"; $(BIN)/python $$script; done

evidence: $(TOOLS)  ## run every study of evidence/, or those named: make evidence turbulence
	@$(BIN)/python -m evidence $(NAMES)

pictures: $(TOOLS)  ## write docs/images/view_*.png (needs chromium), task_*.png, gallery_*.png and the README's figure; docs/writers/pictures.py lists all pictures
	@$(BIN)/python -m docs.writers.pictures
	@$(BIN)/python -m docs.writers.task_pictures
	@$(BIN)/python -m docs.writers.gallery

$(DOCS): $(STAMP)
	$(PIP) '.[docs]'
	@touch $@

docs: $(DOCS)  ## build the documentation site into build/site; a broken link or a warning about a docstring fails
	@$(BIN)/python -m tools.site build

docs-serve: $(DOCS)  ## serve the site at http://localhost:8000 and follow changes of the pages
	@$(BIN)/python -m tools.site serve

docs-zip: $(DOCS)  ## write the site for reading without a server into build/qrsim-docs-VERSION.zip
	@$(BIN)/python -m tools.site zip

docs-publish: $(DOCS)  ## commit the site to the branch gh-pages (ARGS=dev or ARGS=release)
	@$(BIN)/python -m tools.publish_docs $(ARGS)

docs-pages: $(TOOLS)  ## write the pages of docs/reference/ that are generated from the code
	@$(BIN)/python -m tools.reference

proto: $(TOOLS)  ## generate the Python of src/qrsim/links/reference/protocol/qrsim.proto anew
	$(BIN)/python -m grpc_tools.protoc --proto_path=src --python_out=src --pyi_out=src qrsim/links/reference/protocol/qrsim.proto

dist: $(STAMP)  ## build the wheel and the source distribution in dist/, and check them
	rm -rf dist
	$(PIP) '.[release]'
	$(BIN)/python -m build --installer pip
	$(BIN)/python -m twine check --strict dist/*

clean:  ## remove caches and build output (.venv stays)
	rm -rf build dist .cache .pytest_cache .mypy_cache .ruff_cache .import_linter_cache
	find $(CODE) -name __pycache__ -type d -prune -exec rm -rf {} +

help:  ## list the targets
	@grep -hE '^[a-z-]+:.*  ## ' $(MAKEFILE_LIST) | sed -E 's/^([a-z-]+):.*  ## (.*)/\1|\2/' | \
		while IFS='|' read -r target text; do printf '  make %-12s %s\n' "$$target" "$$text"; done
