# Two commands matter: `make demo` shows what the software does, `make test` checks that it does it right.
# Both need only Python 3.11+ and make; everything else goes into .venv.

VENV := .venv
BIN := $(VENV)/bin
# The first interpreter that is new enough; PYTHON=/path/to/python overrides.
PYTHON ?= $(shell for p in python3 python3.14 python3.13 python3.12 python3.11 python; do \
	"$$p" -c 'import sys; sys.exit(sys.version_info < (3, 11))' >/dev/null 2>&1 && { echo "$$p"; break; }; done)
PACKAGES := heliogauge photogrammetry deflectometry observer calibration data_synth
PIP_INSTALL := $(BIN)/python -m pip install --quiet --disable-pip-version-check
# The tests run in two processes; one thread each leaves no core fought over and makes CPU times comparable.
ONE_THREAD := OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1
# Compiled modules are kept, whatever the environment says: tests start many commands.
PYTEST := $(ONE_THREAD) PYTHONDONTWRITEBYTECODE= $(BIN)/python -m pytest -n 2 --dist worksteal

# What open3d needs of the system: installed where apt and rights allow, otherwise named, and its tests skip.
LIBRARIES := libusb-1.0-0 libgl1 libgomp1
# What PDF needs of it: likewise.
PDF_LIBRARIES := libpango-1.0-0 libpangoft2-1.0-0 libharfbuzz-subset0
PDF_LOADS = $(BIN)/python -c 'import weasyprint' >/dev/null 2>&1
OPEN3D_LOADS = $(BIN)/python -c 'import open3d' >/dev/null 2>&1
# The browser in which the views are tested: installed likewise.
HAS_CHROMIUM = { command -v chromium || command -v chromium-browser || command -v google-chrome; } >/dev/null 2>&1
# Debian and Ubuntu keep a part of Python apart.
MAKES_VENVS = "$(PYTHON)" -c 'import venv, ensurepip' >/dev/null 2>&1
AS_ROOT := $(shell [ "$$(id -u)" = 0 ] || echo "sudo -n")
APT_INSTALL = command -v apt-get >/dev/null 2>&1 && $(AS_ROOT) apt-get -qq update >/dev/null 2>&1 && \
	$(AS_ROOT) apt-get -qq install -y --no-install-recommends

.PHONY: help demo test lint quick slow docs bench clean
help:
	@echo "make demo    install the core into $(VENV), measure embedded synthetic data, write demo-result/report.html"
	@echo "make test    style, types, docstrings, quick tests, slow tests"
	@echo "make lint    style and types only"
	@echo "make quick   quick tests only"
	@echo "make docs    build docs/_build/html"
	@echo "make bench   run the benchmarks"
	@echo "make clean   remove $(VENV) and everything built"

demo: .make/core
	$(BIN)/heliogauge demo -o demo-result --force

test: lint quick slow

lint: .make/dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy --strict $(PACKAGES)

quick: .make/dev
	$(PYTEST) -q -m "not slow"

# pytest exits with 5 when no test carries the marker.
slow: .make/dev
	$(PYTEST) -q -m slow || [ $$? -eq 5 ]

docs: .make/docs
	rm -rf docs/reference/api  # pages of modules that are gone
	$(BIN)/sphinx-build -q -W --keep-going -b html docs docs/_build/html
	@echo "docs/_build/html/index.html"

bench: .make/dev
	@for script in benchmarks/[!_]*.py; do echo "== $$script"; $(ONE_THREAD) $(BIN)/python "$$script" || exit 1; done

clean:
	rm -rf $(VENV) .make build dist *.egg-info docs/_build docs/reference/api docs/reference/api.md demo-result .pytest_cache .mypy_cache .ruff_cache

# Stamps: an install runs again only when pyproject.toml changes. The install is editable, so sources need none.
.make/venv:
	@test -n "$(PYTHON)" || { echo "Python 3.11 or newer is needed and was not found; install it or say make PYTHON=/path/to/python3" >&2; exit 1; }
	@$(MAKES_VENVS) || { $(APT_INSTALL) python3-venv >/dev/null 2>&1; } || true
	@$(MAKES_VENVS) || { \
		echo "$(PYTHON) cannot make virtual environments; install its venv package (Debian, Ubuntu: apt install python3-venv)" >&2; exit 1; }
	"$(PYTHON)" -m venv $(VENV)
	@mkdir -p $(@D) && touch $@

.make/core: .make/venv pyproject.toml
	$(PIP_INSTALL) -e .
	@touch $@

.make/dev: .make/venv pyproject.toml
	$(PIP_INSTALL) -e '.[all,dev]'
	@$(OPEN3D_LOADS) || { $(APT_INSTALL) $(LIBRARIES) >/dev/null 2>&1; } || true
	@$(OPEN3D_LOADS) || echo "open3d cannot be imported, so the tests of CAD meshes and PLY files skip; as root: apt-get install $(LIBRARIES)" >&2
	@$(PDF_LOADS) || { $(APT_INSTALL) $(PDF_LIBRARIES) >/dev/null 2>&1; } || true
	@$(PDF_LOADS) || echo "weasyprint cannot be imported, so the tests of PDF skip; as root: apt-get install $(PDF_LIBRARIES)" >&2
	@$(HAS_CHROMIUM) || { $(APT_INSTALL) chromium >/dev/null 2>&1; } || true
	@$(HAS_CHROMIUM) || echo "there is no Chromium, so the tests of the views in a browser skip; as root: apt-get install chromium" >&2
	@touch $@ .make/core

.make/docs: .make/venv pyproject.toml
	$(PIP_INSTALL) -e '.[docs]'
	@touch $@ .make/core
