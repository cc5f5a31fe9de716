# Two commands on a fresh machine:   make book    make test
PY ?= python3
V  := .venv

setup: $(V)/.ok
$(V)/.ok: requirements.txt pyproject.toml
	$(PY) -m venv $(V)
	$(V)/bin/python -m pip install -q --disable-pip-version-check uv
	$(V)/bin/uv pip sync -q --python $(V)/bin/python requirements.txt
	$(V)/bin/uv pip install -q --python $(V)/bin/python --no-deps -e .
	@touch $@
.PHONY: setup
