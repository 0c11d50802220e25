# The environment lives in .venv. It is made once, and brought up to date when pyproject.toml changes.
# STAMP marks an environment that runs blocks; TOOLS marks one that also has the tools for tests and documentation.
# Programs run as "python -m ...": the scripts that pip writes hold an absolute path in their first line, and that line
# breaks where a folder's name is long or has a space.

ifeq ($(OS),Windows_NT)
PY := .venv/Scripts/python.exe
else
PY := .venv/bin/python
endif

# PYTHON names the Python that a new environment is made from; without it, the first supported one is taken.
ifdef PYTHON
CANDIDATES := "$(PYTHON)"
else
CANDIDATES := python3 python3.13 python3.12 python3.11 python
endif

SUPPORTED := import sys; sys.exit(not (3, 11) <= sys.version_info[:2] < (3, 14))
STAMP := .venv/.installed
TOOLS := .venv/.tools
INSTALL = $(PY) -m pip install --quiet --disable-pip-version-check --editable $(1) || { \
	echo "The installation failed; pip says why above. Run make again when the cause is gone."; exit 1; }

# What "make release" works in, and the Python there that builds.
RELEASE := build/release
BUILDER := $(PY:.venv/%=$(RELEASE)/tools/%)

# Modules of another Python, as other tools put them on these paths, must not leak into the environment.
unexport PYTHONPATH PYTHONHOME

# Each worker, and each process that a test starts, would compile all modules again: half a second, and 18 s for tests.
unexport PYTHONDONTWRITEBYTECODE

# The tests that say what happens in a run, which the native engine must pass as well.
BY_BOTH := events hybrid steps instants instant_order enabled loops loops_of_textbooks sampled stepper saved_state \
	random_diagrams no_silent_answers

# A worker for each core; one that has nothing left takes tests from another.
SIDE_BY_SIDE := -n auto --dist worksteal

.PHONY: help demo test test-long browser bench bench-peers docs lint clean ruff mypy layers spelling pytest native long native-long release again

# One stage after the other, also under -j: their output is read from top to bottom.
.NOTPARALLEL:

help:
	@echo "make demo       run the diagrams and the study of the paper"
	@echo "make test       check the code, then run the tests, but for those that take long"
	@echo "make test-long  run the tests that take long"
	@echo "make browser    install Chromium where there is none: the tests of the page in a browser need it"
	@echo "make bench      run the benchmarks; make bench-peers runs other tools on the same diagrams"
	@echo "make docs       build the documentation: build/docs/index.html"
	@echo "make lint       check code and spelling: ruff, mypy, import-linter, codespell"
	@echo "make release    build the sdist and the wheel into dist, and check them; it uploads nothing"
	@echo "make clean      remove the environment, caches and build products"
	@echo
	@echo "The first of them makes an environment in .venv; PYTHON=/path/to/python3 chooses its Python (3.11 to 3.13)."

demo: $(STAMP)
	@echo "== ADRC: diagrams/paper/adrc.json"
	@$(PY) -m blocks run diagrams/paper/adrc.json
	@echo "== IADRC: diagrams/paper/iadrc.json"
	@$(PY) -m blocks run diagrams/paper/iadrc.json
	@echo "== the paper's numbers and ours: diagrams/paper/study.json"
	@$(PY) -m blocks study diagrams/paper/study.json
	@echo "Next: activate the environment in .venv and read docs/start.md (five minutes), or open the documentation: make docs."

lint: ruff mypy layers spelling

test: lint pytest native

# What the marker "long" of pyproject.toml says; .ci/run runs both, always.
test-long: long native-long

# As root, or where sudo asks for no password, on Debian and Ubuntu; else it says what to install.
browser: $(TOOLS)
	@if found=$$($(PY) -c "from tests.support.browser import found; print(found() or '')") && [ -n "$$found" ]; then \
	    echo "== browser: $$found"; exit 0; \
	fi; \
	if ! command -v apt-get >/dev/null; then \
	    echo "There is no Chromium. Install the package chromium (Alpine, Arch, Fedora, Homebrew), or name one by BLOCKS_CHROMIUM."; \
	    exit 1; \
	fi; \
	root=; [ "$$(id -u)" = 0 ] || root="sudo -n"; \
	echo "== installing Debian's chromium"; \
	$$root apt-get update -qq && $$root apt-get install -y -qq --no-install-recommends chromium || { \
	    echo "It could not be installed. As root: apt-get install chromium. Or name one by BLOCKS_CHROMIUM."; exit 1; }

ruff: $(TOOLS)
	@echo "== ruff: style and likely mistakes"
	@$(PY) -m ruff check .

mypy: $(TOOLS)
	@echo "== mypy: types"
	@$(PY) -m mypy

layers: $(TOOLS)
	@echo "== import-linter: layers"
	@$(PY) -X utf8 -c "from importlinter.cli import lint_imports_command as lint; lint()" --no-logo

spelling: $(TOOLS)
	@echo "== codespell: spelling of the pages"
	@$(PY) -m codespell_lib *.md docs blocks/README.md blocks/text/explanations .github

pytest: $(TOOLS)
	@echo "== pytest: tests"
	@$(PY) -m pytest $(SIDE_BY_SIDE)

native: $(TOOLS)
	@echo "== pytest: tests of runs, by the native engine"
	@BLOCKS_ENGINE=native $(PY) -m pytest -q $(SIDE_BY_SIDE) $(BY_BOTH:%=tests/engines/test_%.py)

long: $(TOOLS)
	@echo "== pytest: tests that take long"
	@$(PY) -m pytest -m long $(SIDE_BY_SIDE)

native-long: $(TOOLS)
	@echo "== pytest: tests of runs that take long, by the native engine"
	@BLOCKS_ENGINE=native $(PY) -m pytest -q -m long $(SIDE_BY_SIDE) $(BY_BOTH:%=tests/engines/test_%.py)

bench: $(TOOLS)
	@echo "== benchmarks"
	@$(PY) -m benchmarks

# Each peer gets an environment of its own; together they need about 4 GB and some minutes.
bench-peers: $(TOOLS)
	@echo "== other tools: build/bench-peers"
	@$(PY) -m benchmarks.peers
	@echo "== other masters on the same FMUs"
	@$(PY) -m benchmarks.peers_master

docs: $(TOOLS)
	@echo "== documentation"
	@$(PY) -m sphinx -q -W --keep-going -b html -d build/docs-trees docs build/docs
	@echo "Open build/docs/index.html."

# The sdist is unpacked, and the wheel that it gives is tried in a clean environment of each supported Python that is there.
release: $(STAMP)
	@if [ -n "$$(git status --porcelain 2>/dev/null)" ]; then \
	    echo "Commit or stash your changes first: the sdist holds all files that git does not ignore."; exit 1; \
	fi
	@echo "== tools: $(RELEASE)/tools"
	@rm -rf $(RELEASE) dist
	@$(PY) -m venv $(RELEASE)/tools
	@$(BUILDER) -m pip install --quiet --disable-pip-version-check build || { echo "build could not be installed; pip says why above."; exit 1; }
	@echo "== sdist and wheel: dist"
	@$(BUILDER) -m build --outdir dist . >$(RELEASE)/build.log 2>&1 || { cat $(RELEASE)/build.log; exit 1; }
	@if $(BUILDER) -m pip install --quiet --disable-pip-version-check twine; then \
	    $(BUILDER) -m twine --no-color check --strict dist/*; \
	else \
	    echo "twine could not be installed: skipped its check of the descriptions."; \
	fi
	@echo "== the wheel in clean environments"
	@mkdir $(RELEASE)/sdist
	@tar -xzf dist/*.tar.gz -C $(RELEASE)/sdist --strip-components 1
	@(cd $(RELEASE)/sdist && "$$OLDPWD/$(PY)" -m benchmarks.installing && touch ../passed) 2>&1 | tee $(RELEASE)/tried; [ -e $(RELEASE)/passed ]
	@grep -q " commands; " $(RELEASE)/tried || { echo "No supported Python was found: the wheel was not tried."; exit 1; }
	@grep -qF "## [$$($(PY) -c "import blocks; print(blocks.__version__)")]" CHANGELOG.md || \
	    echo "CHANGELOG.md has no heading for this version: see docs/contributing/release.md."
	@ls -l dist

clean:
	@echo "== removing the environment, caches and build products"
	@rm -rf .venv build dist docs/library .mypy_cache .pytest_cache .ruff_cache .import_linter_cache .hypothesis
	@find . -name .git -prune -o -type d -name __pycache__ -prune -exec rm -rf {} +

# An environment whose Python is gone (upgraded, uninstalled) is made again although its stamp is there.
ifneq ($(shell $(PY) -I -c "print(1)" 2>/dev/null),1)
$(STAMP): again
endif

$(STAMP): pyproject.toml
	@if $(PY) -c "$(SUPPORTED)" 2>/dev/null && $(PY) -m pip --version >/dev/null 2>&1; then exit 0; fi; \
	found=; \
	for candidate in $(CANDIDATES); do \
	    if "$$candidate" -c "$(SUPPORTED)" >/dev/null 2>&1; then found=$$candidate; break; fi; \
	done; \
	if [ -z "$$found" ]; then \
	    echo "blocks needs Python 3.11, 3.12 or 3.13. Tried, and found none that fits:"; \
	    for candidate in $(CANDIDATES); do \
	        echo "    $$candidate: $$("$$candidate" --version 2>/dev/null || echo "does not run")"; \
	    done; \
	    echo "Install one, or name it: make PYTHON=/path/to/python3"; \
	    exit 1; \
	fi; \
	if ! "$$found" -c "import ensurepip, venv" 2>/dev/null; then \
	    echo "$$found has no venv module, which makes the environment."; \
	    echo "On Debian and Ubuntu: sudo apt install python3-venv. Or name another Python: make PYTHON=/path/to/python3"; \
	    exit 1; \
	fi; \
	echo "== environment: .venv, with $$("$$found" --version)"; \
	"$$found" -m venv --clear .venv
	@echo "== installing blocks into .venv (500 MB: half a minute on a fast network)"
	@$(call INSTALL,.)
	@touch $(STAMP)

$(TOOLS): $(STAMP)
	@echo "== installing the tools for tests and documentation into .venv (960 MB more: a minute on a fast network)"
	@$(call INSTALL,".[dev]")
	@touch $(TOOLS)
