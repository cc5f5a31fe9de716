# Two commands on a fresh machine:   make book    make test
PY ?= python3
V  := .venv
UV := 0.13.9
export PATH := $(CURDIR)/$(V)/bin:$(PATH)
export PYVISTA_OFF_SCREEN := true
# a hundred processes import the same packages: let the first one keep what it compiled
unexport PYTHONDONTWRITEBYTECODE
# the products here are small: BLAS threads only get in each other's way
export OMP_NUM_THREADS ?= 1
export OPENBLAS_NUM_THREADS ?= 1
export MKL_NUM_THREADS ?= 1
# a folder of shape collections; the chapters use its tosca_cat when it has one
export FMSYNC_DATA
JOBS ?= 2
HTML := _build/html/index.html
# pages and zip carry the date of the last commit: the same commit renders to the same bytes
DATE := $(shell git log -1 --format=%ct 2>/dev/null)
ifneq ($(DATE),)
export SOURCE_DATE_EPOCH ?= $(DATE)
endif
.PHONY: setup book book.zip test worlds fuzz lint unit core notebook-test browser notebooks lab clean

book: setup
	python scripts/sync_notebooks.py --check
	python scripts/build_book.py --jobs $(JOBS)

# the rendered book in one file that opens from disk, _build/book.zip: the same pages give the same bytes
# 1980, where the dates of zip files begin
FIRST := 315532800
book.zip: book
	rm -rf _build/fmsync-book && cp -r _build/html _build/fmsync-book
	find _build/fmsync-book -name '.*' -type f -delete
	date=$${SOURCE_DATE_EPOCH:-0}; test $$date -ge $(FIRST) || date=$(FIRST); \
	  find _build/fmsync-book -exec touch -d @$$date {} +
	chmod -R u=rwX,go=rX _build/fmsync-book
	cd _build && TZ=UTC python -m zipfile -c book.part fmsync-book && mv book.part book.zip && rm -r fmsync-book

test: lint unit notebook-test browser

lint: setup
	ruff check .
	ruff format --check .
	lint-imports
	mypy
	codespell

# make unit COVERAGE="--cov --cov-report=term:skip-covered": which lines are tested; a third slower
unit: setup
	pytest -q -n $(JOBS) --dist worksteal -p no:nbmake -m "not browser and not slow" $(COVERAGE)

# the library without extras, in an environment of its own, with the oldest or newest releases that its bounds admit:
# make core PINS=lowest
PINS ?= highest
core:
	$(PY) -m venv --clear $(V)-core
	$(V)-core/bin/python -m pip install -q --disable-pip-version-check uv==$(UV)
	$(V)-core/bin/uv pip install -q --python $(V)-core/bin/python --resolution $(if $(filter lowest,$(PINS)),lowest-direct,highest) .
	$(V)-core/bin/uv pip install -q --python $(V)-core/bin/python pytest hypothesis mpmath
	$(V)-core/bin/python -m pytest -q -m "not browser and not slow" README.md tests/test_energy.py tests/test_problem.py tests/test_langevin.py \
	  tests/test_bounds.py tests/test_diagnostics.py tests/estimators/test_certificate.py tests/estimators/test_map.py tests/samplers/test_sample.py

# in the arithmetic of another processor than make book, so that one machine tests two
notebook-test: setup
	python scripts/other_arithmetic.py pytest -q -n $(JOBS) --dist worksteal -o addopts= --nbmake --nbmake-timeout=600 book/notebooks

# last, so that the summary of what was looked at in the browser ends the log
browser: setup
	test -f $(HTML) || $(MAKE) book
	pytest -q -rs -n $(JOBS) --dist worksteal -m browser tests/test_book_browser.py tests/matching/test_report_browser.py

# every chapter in eight worlds, the arithmetic of two processors by four shifts of all seeds: make worlds CHAPTERS="05_oracle 04_rlfm" SEED=1
worlds: setup
	python scripts/worlds.py $(CHAPTERS) --seed $(or $(SEED),0) --jobs $(JOBS)

# damaged files for every reader; what makes one crash, hang or raise anything but a ValueError goes to tests/broken
MUTANTS ?= 2000
fuzz: setup
	python -m tests.fuzz --mutants $(MUTANTS)

notebooks: setup
	python scripts/sync_notebooks.py

lab: setup notebooks
	jupyter lab $(if $(filter 0,$(shell id -u)),--allow-root) book/notebooks

clean:
	rm -rf _build

setup: $(V)/.ok
$(V)/.ok: requirements.txt pyproject.toml
	$(PY) -m venv $(V)
	$(V)/bin/python -m pip install -q --disable-pip-version-check uv==$(UV)
	$(V)/bin/uv pip sync -q --python $(V)/bin/python requirements.txt
	$(V)/bin/uv pip install -q --python $(V)/bin/python --no-deps -e .
	@touch $@
