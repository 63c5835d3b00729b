# Two commands for a newcomer: `make demo` and `make test`. Both set up what they need in .venv.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
PIP := $(BIN)/python -m pip --disable-pip-version-check --quiet

.PHONY: demo test benchmark lint format contract types tests lock clean clean-cache
.DEFAULT_GOAL := help

.PHONY: help
help:
	@echo "make demo   set up, then measure a virtual half ball: from pictures to constants"
	@echo "make test   set up, then lint, format check, import contract, types, tests"
	@echo "make benchmark  measure every figure, write BENCHMARK.md (about an hour)"
	@echo "make lock   choose new pinned versions"
	@echo "make clean  remove the environment and every cache"

# The stamps tell which lock file an environment was made from.
$(VENV)/run.stamp: requirements.lock pyproject.toml
	$(PYTHON) -m venv $(VENV)
	$(PIP) install -r requirements.lock
	$(PIP) install --no-deps --no-build-isolation --editable .
	touch $@

$(VENV)/lab.stamp: requirements-lab.lock $(VENV)/run.stamp
	$(PIP) install -r requirements-lab.lock
	touch $@

$(VENV)/dev.stamp: requirements-dev.lock $(VENV)/run.stamp
	$(PIP) install -r requirements-dev.lock
	touch $@

demo: $(VENV)/lab.stamp
	$(BIN)/palpate lab demo demo-session
	$(BIN)/palpate fit demo-session --out demo-result || [ $$? -eq 3 ]

test: lint contract types tests

lint: $(VENV)/dev.stamp
	$(BIN)/ruff check src tests benchmarks examples
	$(BIN)/ruff format --check src tests benchmarks examples
	$(BIN)/codespell src tests benchmarks docs README.md CHANGELOG.md CONTRIBUTING.md

contract: $(VENV)/dev.stamp
	$(BIN)/lint-imports

types: $(VENV)/dev.stamp
	$(BIN)/mypy

tests: $(VENV)/dev.stamp clean-cache
	$(BIN)/python -m pytest -n 2 --dist loadfile

format: $(VENV)/dev.stamp
	$(BIN)/ruff check --fix src tests benchmarks examples
	$(BIN)/ruff format src tests benchmarks examples

PIN := $(BIN)/pip-compile --quiet --upgrade --strip-extras --no-header --no-annotate \
    --no-emit-index-url --no-emit-trusted-host --no-emit-find-links --no-emit-options
DEV_GROUP := import tomllib; \
    print(*tomllib.load(open('pyproject.toml', 'rb'))['dependency-groups']['dev'], sep='\n')

lock:
	$(PYTHON) -m venv $(VENV)
	$(PIP) install pip-tools
	$(PIN) --output-file requirements.lock pyproject.toml requirements-build.in
	$(BIN)/python -c "$(DEV_GROUP)" > $(VENV)/dev.in
	$(PIN) --constraint requirements.lock --output-file requirements-dev.lock $(VENV)/dev.in
	$(PIN) --constraint requirements-dev.lock --extra lab --output-file $(VENV)/lab.all pyproject.toml
	grep -vxFf requirements.lock $(VENV)/lab.all > requirements-lab.lock

benchmark: $(VENV)/dev.stamp
	$(BIN)/python -m benchmarks.run --peers

clean-cache:
	find src -name '*.nb[ic]' -delete

clean: clean-cache
	rm -rf $(VENV) .mypy_cache .pytest_cache .ruff_cache .import_linter_cache .hypothesis build dist
	find src tests benchmarks -name __pycache__ -type d -exec rm -rf {} +
