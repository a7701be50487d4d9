# Everything runs from .venv, which is made once and again only when requirements.lock or pyproject.toml changes.

PYTHON ?= python3
ARGS ?=
PYTEST_ARGS ?=
LOCK_ARGS ?=

BIN := .venv/bin
PACKAGES := association data ekf eval graph wings

# Kernels are compiled again where their source changed, or that of a module they use (data/compiled.py).
KERNELS := $(shell grep -lsr --include=*.py njit $(wildcard $(PACKAGES))) $(wildcard eval/warm.py eval/plan/warming.py)

export MPLBACKEND := Agg
# Without bytecode, every process and test worker would compile everything again.
unexport PYTHONHOME PYTHONPATH VIRTUAL_ENV PYTHONDONTWRITEBYTECODE

.DEFAULT_GOAL := help
.DELETE_ON_ERROR:
.PHONY: help venv report test checked test-slow pythons test-browser looks mutants benchmark variety docs site firmware lock lowest release clean

help: ## this list
	@grep -E '^[a-z-]+:.*## ' $(firstword $(MAKEFILE_LIST)) | sed -E 's/^([a-z-]+):.*## (.*)/  \1\t\2/' | expand -t 14
	@echo 'Variables: PYTHON=$(PYTHON), ARGS (report, mutants, benchmark, studies), PYTEST_ARGS (test, test-slow), LOCK_ARGS (lock)'

venv: .venv/.warm ## make .venv and compile the kernels

report: .venv/.warm ## write the report; ARGS='--quick --out DIR'
	$(BIN)/python -m eval.run_all $(ARGS)

# types are checked on one core while the kernels are compiled on another
test: .venv/.installed ## style, types, import rules, tests; PYTEST_ARGS='-k jcbb'
	@$(MAKE) --no-print-directory -j2 checked .venv/.warm
	$(BIN)/python -m pytest -n 2 --dist worksteal $(PYTEST_ARGS)

checked: .venv/.installed
	@! git grep -nE '^(<{7}|>{7}|={7})( |$$)' || { echo 'unresolved merges in the lines above'; exit 1; }
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

test-slow: .venv/.warm ## the tests that take long, and those of tests/research
	$(BIN)/python -m pytest -n 2 --dist worksteal -m "(slow or hypothesis) and not browser" --hypothesis-profile thorough \
	    $(PYTEST_ARGS)
	$(BIN)/python -m pytest -n 2 --dist worksteal -m "" tests/research $(PYTEST_ARGS)

test-browser: .venv/.warm .venv/.browser ## the player in a real browser (Chromium on PATH)
	$(BIN)/python -m pytest -m browser tests/browser $(PYTEST_ARGS)

looks: .venv/.warm .venv/.browser ## pictures of twelve pages at 1400, 800 and 400 px in build/looks, to be looked at
	$(BIN)/python -m tests.browser.looks $(ARGS)

mutants: .venv/.warm ## the fixed set of faults: the tests still find each; ARGS='--draw 40 --seed 7' tries others
	$(BIN)/python -m tests.mutation.sampled $(ARGS)

benchmark: .venv/.warm ## frames per second
	$(BIN)/python -m eval.benchmark $(ARGS)

variety: .venv/.warm ## jcbb and jcbb-hindsight on many simulated worlds; ARGS='OUT --half judge'
	$(BIN)/python -m tests.research variety $(ARGS)

docs: .venv/.warm ## write the generated pages, and the measured numbers into all pages
	$(BIN)/python -m tests.documents $(ARGS)

site: .venv/.warm .venv/.site ## build the documentation site into build/site, strict
	NO_MKDOCS_2_WARNING=1 $(BIN)/python -m mkdocs build --strict --site-dir build/site

firmware: ## build the small robot's firmware into build/firmware; needs avr-gcc
	@$(MAKE) --no-print-directory -C docs/robot/firmware OUT=$(CURDIR)/build/firmware

PINNED := .venv/lock/bin/uv pip compile --no-config --system-certs --quiet --universal --fork-strategy fewest --python-version 3.11 \
    --generate-hashes --custom-compile-command 'make lock'
lock: ## pin both lock files anew; LOCK_ARGS=--upgrade for the newest versions
	$(PYTHON) -m venv .venv/lock
	.venv/lock/bin/python -m pip install --quiet uv
	$(PINNED) $(LOCK_ARGS) --extra dev --output-file requirements.lock pyproject.toml
	$(PINNED) $(LOCK_ARGS) --extra site --constraints requirements.lock --output-file requirements-site.lock pyproject.toml

TOOLS := pytest pytest-xdist hypothesis rosbags h5py smfeval distributed hatchling
PART := tests/association tests/ekf tests/graph tests/eval/referee
# deprecations of newer packages beside the oldest ones are no faults of ours, hence -W default
lowest: .venv/lowest/.installed ## the fast tests with the oldest packages that pyproject.toml allows, in .venv/lowest
	.venv/lowest/bin/python -m pytest -n 2 --dist worksteal -W default $(PYTEST_ARGS)

.venv/lowest/.installed: pyproject.toml
	$(PYTHON) -m venv .venv/lowest
	.venv/lowest/bin/python -m pip install --quiet uv
	.venv/lowest/bin/uv pip compile --no-config --system-certs --quiet --resolution lowest-direct --only-binary :all: \
	    --output-file .venv/lowest/pins.txt pyproject.toml
	VIRTUAL_ENV=.venv/lowest .venv/lowest/bin/uv pip install --no-config --system-certs --quiet -r .venv/lowest/pins.txt -e . $(TOOLS)
	touch $@

pythons: ## the newest packages on every newer Python that is there, a part of the tests
	for v in 3.12 3.13 3.14; do python$$v -c '' 2>/dev/null || continue; \
	    python$$v -m venv .venv/py$$v && .venv/py$$v/bin/python -m pip install --quiet -e . $(TOOLS) \
	    && .venv/py$$v/bin/python -m pytest -n 2 --dist worksteal -W default $(PYTEST_ARGS) $(PART) || exit 1; done

# the sdist gives the same wheel; a user's files with the names of our packages are no obstacle
release: .venv/.installed ## wheel, sdist, recipe and notes of the version in dist, tried in an empty environment; uploads nothing
	rm -rf dist build/release build/again
	$(BIN)/python -m hatchling build -d dist
	$(BIN)/python -m pip wheel --quiet --no-deps --no-build-isolation -w build/again dist/*.tar.gz
	cmp dist/*.whl build/again/*.whl
	$(PYTHON) -m venv build/release
	build/release/bin/python -m pip install --quiet dist/*.whl
	mkdir build/release/user && cd build/release/user && mkdir data && touch data/__init__.py eval.py graph.py \
	    && ../bin/slamref run arena:0 --no-plots --out report && ../bin/slamref inspect arena:0 \
	    && ../bin/python -c "import slamref; assert len(slamref.open_log('arena:0').recorded)"
	version=$$($(BIN)/python -m hatchling version) && sha=$$(sha256sum dist/*.tar.gz | cut -d' ' -f1) \
	    && sed "s/VERSION/$$version/; s/SHA256/$$sha/" packaging/recipe.yaml > dist/recipe.yaml \
	    && grep -q "^version: $$version$$" CITATION.cff && grep -q "^## \[$$version\]" CHANGELOG.md
	awk '/^## /{n++} n==1' CHANGELOG.md > dist/notes.md

clean: ## remove .venv and every cache; results/ stays
	rm -rf .venv .hypothesis .import_linter_cache .mypy_cache .pytest_cache .ruff_cache build dist
	find $(wildcard $(PACKAGES) tests) /dev/null -name __pycache__ -type d -prune -exec rm -rf {} +

# what is imported is compiled then: not half of all files of the packages ever is
.venv/.installed: requirements.lock pyproject.toml
	@$(PYTHON) -c 'import sys; sys.version_info < (3, 11) and sys.exit("slamref needs Python 3.11 or newer, not " + sys.version)'
	@$(BIN)/python -m pip --version >/dev/null 2>&1 || $(PYTHON) -m venv --clear .venv
	$(BIN)/python -m pip install --quiet --no-compile --require-hashes -r requirements.lock
	$(BIN)/python -m pip install --quiet --no-deps --no-build-isolation -e .
	@touch $@

.venv/.browser: .venv/.installed
	$(BIN)/python -m pip install --quiet --no-build-isolation -e '.[browser]'
	@touch $@

.venv/.site: .venv/.installed requirements-site.lock
	$(BIN)/python -m pip install --quiet --require-hashes -r requirements-site.lock
	@touch $@

.venv/.warm: .venv/.installed $(KERNELS)
	$(BIN)/python -m eval.warm
	@touch $@
