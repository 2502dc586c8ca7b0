# .ci/setup installs what is missing and leaves the interpreter in $python.
SETUP = set -e; root=$$PWD; . .ci/setup

.PHONY: setup test run studies bench portability lint clean

setup:
	@needs="pytest hypothesis"; $(SETUP)

test:
	@needs="pytest hypothesis"; wants="vtk xdist"; $(SETUP); \
	"$$python" -c "import xdist" 2>/dev/null && workers="-n auto"; \
	"$$python" -m pytest $$workers $(ARGS)

run:
	@./run $(ARGS)

# make studies ARGS=-quick: half an hour instead of some four hours
studies:
	@needs="matplotlib"; $(SETUP); "$$python" -m petscib.studies $(ARGS)

# make bench ARGS=-quick: a version of minutes, up to 128^2
bench:
	@needs="matplotlib"; $(SETUP); "$$python" -m petscib.studies.bench $(ARGS)

# make portability SUITE=trixie ARGS='make test': README's commands, or these, on a bare Debian
portability:
	@.ci/portability $(ARGS)

lint:
	@needs="ruff"; $(SETUP); "$$python" -m ruff check

clean:
	rm -rf build dist *.egg-info .pytest_cache .ruff_cache .hypothesis
	find . -name __pycache__ -not -path './.venv/*' -prune -exec rm -rf {} +
