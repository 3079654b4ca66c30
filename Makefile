# make setup   system libraries where they can be installed, .venv, pinned packages
# make run     the window on the built-in synthetic sensor; ARGS="open REC" passes arguments
# make test    the quick tests in three processes; ARGS="-k recording" passes arguments
# make test-all  the long ones too: studies, the real press, every command of the pages
# make lint    ruff, mypy and the order of rooms (import-linter)
# make docs    the pages into site/, warnings as errors
# make pages   of make test-all, what tests the pages
# make lock    pin again what pyproject.toml asks for (needs uv)
.PHONY: setup run test test-all lint docs pages lock

setup:
	@.ci/setup

run: setup
	@.venv/bin/bubbleviz $(ARGS)

test test-all: setup
	.venv/bin/python -m pytest -n 3 --max-worker-restart 0 --dist loadfile \
	    --no-loadscope-reorder $(ARGS)

test-all pages: export TEST_ALL = 1
# Even where the environment forbids it: else every process of a test compiles what it imports
test test-all pages: export PYTHONDONTWRITEBYTECODE =
# On two cores: the third process computes while another waits for a robot or a clock, and more
# threads of linear algebra would only wait for each other
test test-all: export OMP_NUM_THREADS = 1

lint: setup
	.venv/bin/ruff check .
	.venv/bin/ruff format --check .
	.venv/bin/mypy
	PYTHONPATH=.:ui .venv/bin/lint-imports --no-cache

docs: .venv/docs/installed
	NO_MKDOCS_2_WARNING=1 .venv/docs/bin/mkdocs build

# In an environment of its own: nothing but the pages needs these packages
.venv/docs/installed: docs/requirements.txt | setup
	.venv/bin/python -m venv --clear .venv/docs
	.venv/docs/bin/python -m pip --disable-pip-version-check install --quiet \
	    --require-hashes -r docs/requirements.txt
	touch $@

pages: setup
	.venv/bin/python -m pytest tests/docs $(ARGS)

lock:
	uv pip compile pyproject.toml --group dev --all-extras --universal --generate-hashes --no-header \
	    --no-annotate -o requirements.txt
	uv pip compile --group docs --universal --generate-hashes --no-header \
	    --no-annotate -o docs/requirements.txt
