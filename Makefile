# Two commands for a newcomer: `make demo` and `make test`. Both set up what they need in .venv.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
PIP := $(BIN)/python -m pip --disable-pip-version-check --quiet

# What is ours and written in Python; what a stale kernel could come from: the rooms that have kernels,
# and those below that these may take a constant from.
PYTHON_FILES := src tests benchmarks examples docs
KERNEL_ROOMS := geometry records probe contact bem vision lab simulation solids
KERNEL_SOURCES := $(shell find $(KERNEL_ROOMS:%=src/palpate/%) -name '*.py')

.PHONY: demo test slow fuzz fuzz-coverage benchmark lint format contract types tests map reference docs dist release lock \
    oldest clean clean-cache
.DEFAULT_GOAL := help

.PHONY: help
help:
	@echo "make demo   set up, then measure a virtual half ball: from pictures to constants"
	@echo "make test   set up, then lint, format check, import contract, types, tests"
	@echo "make slow   the tests that take longer than some seconds each: before a release"
	@echo "make fuzz   read ten thousand damaged files of every kind (some ten minutes)"
	@echo "make fuzz-coverage  the same, led by the lines that run (SECONDS=1800)"
	@echo "make benchmark  measure every figure, write BENCHMARK.md (about two hours)"
	@echo "make docs   build the documentation site in build/docs (opens from the disk, no network)"
	@echo "make reference  make docs/reference and the gallery again from the code that reads the files"
	@echo "make dist   build wheel and sdist, install in a fresh environment, fit an example there"
	@echo "make release  test, then the wheel, the sdist and the documentation, ready to be uploaded"
	@echo "make oldest install the oldest versions that the metadata promises, run some tests with them"
	@echo "make map    draw docs/developer/map.svg again, after a change of rooms or imports"
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

# Kernels are compiled by one processor: beside the rendering, shown after it.
demo: $(VENV)/lab.stamp
	@$(MAKE) --no-print-directory $(VENV)/kernels.stamp > $(VENV)/kernels.txt 2>&1 & kernels=$$!; \
	$(BIN)/palpate lab demo demo-session || exit; \
	wait $$kernels; kernels=$$?; cat $(VENV)/kernels.txt; exit $$kernels
	$(BIN)/palpate fit demo-session --out demo-result || [ $$? -eq 3 ]

# Contracts and types keep one processor busy for a minute: beside the tests, shown after them.
test: lint
	@$(MAKE) --no-print-directory contract types > $(VENV)/beside.txt 2>&1 & beside=$$!; \
	$(MAKE) --no-print-directory tests; tests=$$?; \
	wait $$beside; beside=$$?; cat $(VENV)/beside.txt; [ $$tests -eq 0 ] && [ $$beside -eq 0 ]

lint: $(VENV)/dev.stamp
	$(BIN)/ruff check $(PYTHON_FILES)
	$(BIN)/ruff format --check $(PYTHON_FILES)
	$(BIN)/codespell $(PYTHON_FILES) README.md CHANGELOG.md CONTRIBUTING.md SECURITY.md

contract: $(VENV)/dev.stamp
	$(BIN)/lint-imports

types: $(VENV)/dev.stamp
	$(BIN)/mypy

# One thread of linear algebra in each of the two processes: more would wait for each other. Compiled
# modules are kept whatever the environment says: a hundred tests start processes of their own.
PYTEST := PYTHONDONTWRITEBYTECODE= OPENBLAS_NUM_THREADS=1 $(BIN)/python -m pytest -n 2 --dist loadfile \
    --no-loadscope-reorder

tests: $(VENV)/dev.stamp $(VENV)/kernels.stamp
	$(PYTEST) -m "not slow"

slow: $(VENV)/dev.stamp $(VENV)/kernels.stamp
	$(PYTEST) -m slow

# numba looks at the file of the kernel that is called, not at those that this one calls: kernels on
# disk that are older than any source of theirs may hold old code.
$(VENV)/kernels.stamp: $(KERNEL_SOURCES) | $(VENV)/run.stamp
	find src -name '*.nb[ic]' -delete
	$(BIN)/palpate compile
	touch $@

fuzz: $(VENV)/dev.stamp
	PALPATE_FUZZ_EXAMPLES=225 $(BIN)/python -m pytest tests/faults/test_fuzz.py -n 2

# Led by the lines that run; atheris, which few systems have, stays out of the locks. Kernels run as
# Python: what is compiled cannot be watched.
SECONDS ?= 1800
fuzz-coverage: $(VENV)/dev.stamp
	$(PIP) install atheris
	NUMBA_DISABLE_JIT=1 PYTHONPATH=src:.:tests $(BIN)/python tests/faults/fuzz_coverage.py \
	    -max_total_time=$(SECONDS) -max_len=12000 -timeout=30

format: $(VENV)/dev.stamp
	$(BIN)/ruff check --fix $(PYTHON_FILES)
	$(BIN)/ruff format $(PYTHON_FILES)

PIN := $(BIN)/pip-compile --quiet --upgrade --strip-extras --no-header --no-annotate \
    --no-emit-index-url --no-emit-trusted-host --no-emit-find-links --no-emit-options
DEV_GROUP := import tomllib; \
    print(*tomllib.load(open('pyproject.toml', 'rb'))['dependency-groups']['dev'], sep='\n')

DOCS_GROUP := $(subst 'dev','docs',$(DEV_GROUP))

lock:
	$(PYTHON) -m venv $(VENV)
	$(PIP) install pip-tools
	$(PIN) --output-file requirements.lock pyproject.toml requirements-build.in
	$(BIN)/python -c "$(DEV_GROUP)" > $(VENV)/dev.in
	$(PIN) --constraint requirements.lock --output-file requirements-dev.lock $(VENV)/dev.in
	$(BIN)/python -c "$(DOCS_GROUP)" > $(VENV)/docs.in
	$(PIN) --constraint requirements.lock --constraint requirements-dev.lock \
	    --output-file requirements-docs.lock $(VENV)/docs.in
	$(PIN) --constraint requirements-dev.lock --extra lab --output-file $(VENV)/lab.all pyproject.toml
	grep -vxFf requirements.lock $(VENV)/lab.all > requirements-lab.lock

benchmark: $(VENV)/dev.stamp
	$(BIN)/python -m benchmarks.run --peers

map: $(VENV)/dev.stamp
	$(BIN)/python docs/developer/make_map.py

# Pages that follow from the code; `make test` checks that they are current.
reference: $(VENV)/dev.stamp
	$(BIN)/python docs/site/make_reference.py

$(VENV)/docs.stamp: requirements-docs.lock $(VENV)/run.stamp
	$(PIP) install -r requirements-docs.lock
	touch $@

docs: $(VENV)/docs.stamp
	$(BIN)/python -m sphinx -W --keep-going -q -c docs/site docs build/docs
	@echo "Open build/docs/index.html"

# Installed outside the tree: an installed Palpate has nothing beside it.
dist: $(VENV)/run.stamp
	rm -rf build/dist build/fresh
	$(BIN)/python -m hatchling build -d build/dist
	$(PYTHON) -m venv build/fresh
	build/fresh/bin/python -m pip install --quiet build/dist/*.tar.gz
	cd build/fresh && bin/palpate --version && bin/palpate fit ../../examples/half_ball --out result

# Made from what is committed, under a version that the changelog has a section for.
VERSION = $(shell sed -n 's/^__version__ = "\(.*\)"/\1/p' src/palpate/__init__.py)

release:
	@test -z "$$(git status --porcelain)" || { echo "not all is committed: see git status"; exit 2; }
	@grep -q "^## \[$(VERSION)\]" CHANGELOG.md || { echo "CHANGELOG.md has no section [$(VERSION)]:" \
	    "rename [Unreleased], or set __version__ in src/palpate/__init__.py"; exit 2; }
	$(MAKE) --no-print-directory test docs dist
	tar -czf build/dist/palpate-$(VERSION)-docs.tar.gz -C build docs
	@ls -l build/dist
	@echo "Left to do: git tag v$(VERSION), push the tag, upload the wheel and the sdist"

# The oldest versions that the metadata promises, with the newest tools for testing. Shapes are not
# checked: that needs a newer jaxtyping than a run does. Kernels stay out of the tree. With the oldest
# of cyclopts and rich `--help` takes longer and a stopped command writes an empty line more: tests
# of the terminal are not among these.
OLDEST := import tomllib; p = tomllib.load(open('pyproject.toml', 'rb'))['project']; \
    more = p['optional-dependencies']; \
    print(*(d.replace('>=', '==') for d in p['dependencies'] + more['hdf5']), sep='\n')
OLDEST_TESTS := tests/api tests/geometry tests/records tests/figures tests/estimation

oldest:
	$(PYTHON) -m venv build/oldest
	build/oldest/bin/python -c "$(OLDEST)" > build/oldest/run.in
	build/oldest/bin/python -m pip install --quiet -r build/oldest/run.in pytest beartype hypothesis
	NUMBA_CACHE_DIR=build/oldest/kernels PYTHONPATH=src build/oldest/bin/python -m pytest -q \
	    -o addopts="--import-mode=importlib --strict-markers" -W ignore::DeprecationWarning $(OLDEST_TESTS)

clean-cache:
	find src -name '*.nb[ic]' -delete

clean: clean-cache
	rm -rf $(VENV) .mypy_cache .pytest_cache .ruff_cache .import_linter_cache .hypothesis build
	find $(PYTHON_FILES) -name __pycache__ -type d -exec rm -rf {} +
