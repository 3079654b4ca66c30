# make setup   system libraries where they can be installed, .venv, pinned packages
# make run     the window on the built-in synthetic sensor; ARGS="open REC" passes arguments
# make test    the whole test suite in two processes; ARGS="-k recording" passes arguments
# make lint    ruff and mypy
# make lock    pin again what pyproject.toml asks for (needs uv)
.PHONY: setup run test lint lock

setup:
	@.ci/setup

run: setup
	@.venv/bin/bubbleviz $(ARGS)

test: setup
	.venv/bin/python -m pytest -n 2 --dist loadfile --no-loadscope-reorder $(ARGS)

lint: setup
	.venv/bin/ruff check .
	.venv/bin/ruff format --check .
	.venv/bin/mypy

lock:
	uv pip compile pyproject.toml --group dev --all-extras --universal --generate-hashes --no-header \
	    --no-annotate -o requirements.txt
