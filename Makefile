# SPDX-License-Identifier: Apache-2.0
# Every target works in a fresh clone; .ci/setup makes .venv where it is missing.
.PHONY: docs versions lowest image model browser engines sensitivity latency handoffs ros ros-whole throughput quality demo experiment evaluation test test-fast check style setup audit bench faults managers fuzz slow-links soak clean containers
PY := .venv/bin/python
export PYTHON

demo:
	@.ci/setup
	@$(PY) -m tests.demo

setup:
	@.ci/setup dev

# Known holes in what edgectl depends on: docs/dependencies.md.
audit: setup
	@.ci/audit

check: style
	@.venv/bin/mypy

style: setup
	@.venv/bin/ruff format --check .
	@.venv/bin/ruff check .

# More workers than cores: most tests wait for real hosts, and each makes hosts of its own. A failed test is run
# once more, alone, and named (docs/adr/0030-rerun-failed-tests-once.md).
WORKERS ?= 8
test: style
	@.ci/need-faults
	@.ci/need-promtool
	@.ci/need-schemas
	@.ci/need-etcd
	@.ci/need-docker
	@.ci/need-shells
	@.ci/need-tlc
	@PATH="$$PATH:/usr/sbin:/sbin" .ci/beside $(PY) -m tests.suite tests --ignore=tests/benchmarks --ignore=tests/ros --ignore=tests/engines --ignore=tests/browser --ignore=tests/containers/test_lifecycle.py --ignore=tests/containers/test_losses.py --ignore=tests/containers/test_apply.py --ignore=tests/containers/test_swarm.py --ignore=tests/containers/test_swarm_moves.py --ignore=tests/containers/test_image.py -n $(WORKERS) --dist loadfile --no-loadscope-reorder

# Tests without real hosts: rules, files, documents, views, and simulated fleets.
PURE := config doctor experiments executor export formats fuzz gateway importers model rules scheduler simulation state tui usecases views web test_rooms.py
test-fast: setup
	@.ci/need-promtool
	@.ci/need-schemas
	@.ci/need-etcd
	@$(PY) -m tests.suite $(PURE:%=tests/%) -m "not slow" -n 2 --dist loadfile --no-loadscope-reorder

# The fast suite with each other Python that is here (3.12 to 3.14), and with every dependency at the floor that pyproject.toml
# states: .ci/pythons and .ci/lowest make environments of their own.
versions: setup
	@.ci/need-promtool
	@.ci/need-etcd
	@.ci/pythons $(PURE:%=tests/%) -m "not slow" -n 2 --dist loadfile --no-loadscope-reorder
	@$(MAKE) --no-print-directory lowest

lowest: setup
	@.ci/need-promtool
	@.ci/need-etcd
	@.ci/lowest $(PURE:%=tests/%) -m "not slow" -n 2 --dist loadfile --no-loadscope-reorder

# On a real ROS 1, out of Debian's packages, and rclpy of ROS 2, which are installed where they are missing; without them this fails.
# make ros LAUNCH=all imports and runs all launch files of the tests, not two of them: five minutes more.
ros: setup
	@.ci/need-ros
	@.ci/need-faults
	@PATH="$$PATH:/usr/sbin:/sbin" ROS_LAUNCH=$(LAUNCH) $(PY) -m tests.suite tests/ros -n 2 --dist loadfile --no-loadscope-reorder

# Fifty stops of nodes that do not end as they should, of ROS 1 and of ROS 2; half an hour. Then the table of moves in docs/ros.md.
ros-whole: setup
	@.ci/need-ros
	@.ci/need-faults
	@PATH="$$PATH:/usr/sbin:/sbin" $(PY) -m tests.suite --whole tests/ros/test_stops.py
	@PATH="$$PATH:/usr/sbin:/sbin" $(PY) -m tests.ros.moves

# Gap and overlaps of warm moves between computers in network namespaces (root): docs/concepts/handoff.md.
# make handoffs NODE=ros2 moves a lifecycle node of ROS 2, of which make ros runs a short form.
handoffs: setup
	@$(if $(filter ros2,$(NODE)),.ci/need-ros)
	@PATH="$$PATH:/usr/sbin:/sbin" $(PY) -m tests.handoffs --node $(or $(NODE),tcp) --moves $(or $(MOVES),200)

# Byte counters against interfaces for ten mixes of TCP, Fast DDS and Cyclone DDS: the table of docs/performance.md. Some minutes.
# A short form runs in the suite.
throughput: setup
	@.ci/need-ros
	@PATH="$$PATH:/usr/sbin:/sbin" $(PY) -m tests.ros.throughput --window $(or $(WINDOW),10)

bench: setup
	@.ci/need-sshd
	@PATH="$$PATH:/usr/sbin:/sbin" $(PY) -m tests.benchmarks

# Probe, plan, apply and watch over far, lossy and slow lines, beside ssh doing the same (root): docs/performance.md. Ten minutes.
slow-links: setup
	@.ci/need-faults
	@PATH="$$PATH:/usr/sbin:/sbin" $(PY) -m tests.slow_links $(or $(RUNS),3)

# The figures of docs/concepts/quality.md: how far plans are from the best ones. Some minutes.
quality: setup
	@$(PY) -m tests.quality

# Predicted against measured latency behind shaped links, and misses with deadlines: the tables of
# docs/concepts/predicted-latency.md. Half an hour on a machine that does nothing else; JOBS=100 takes ten minutes.
latency: setup
	@.ci/need-faults
	@PATH="$$PATH:/usr/sbin:/sbin" $(PY) -m tests.latency --jobs $(or $(JOBS),600)

# Sweeps on a real Ray, Dask and Slurm of one node (root), which are installed where they are missing: docs/concepts/sweeps.md.
engines: setup
	@.ci/need-engines
	@PATH="$$PATH:/usr/sbin:/sbin" $(PY) -m tests.suite tests/engines -n 0

# The table and the figure of docs/evaluation/sensitivity.md, from its committed results; worlds that are missing are simulated.
sensitivity: setup
	@$(PY) -m tests.experiments.sensitivity

# Tasks in containers of a real Docker Engine (root), whose programs it takes out of Debian's packages: docs/concepts/containers.md.
# A short form runs in the suite. Then the image of edgectl itself, on a base of Debian's packages.
containers: setup
	@.ci/need-docker
	@PATH="$$PATH:/usr/sbin:/sbin" $(PY) -m tests.suite tests/containers -n 0

# The page of edgectl serve in a real Chromium, which is installed where it is missing: docs/concepts/serve.md. Screenshots in runs/browser.
browser: setup
	@.ci/need-browser
	@$(PY) -m tests.suite tests/browser -n 0

# The whole fault matrix on real hosts, over commands and over containers; make faults SEED=7 draws other moments and bytes.
# Then a death of the manager at each failpoint, and a hundred random lives, over simulated hosts.
faults: setup
	@.ci/need-faults
	@.ci/need-etcd
	@.ci/need-docker
	@PATH="$$PATH:/usr/sbin:/sbin" $(PY) -m tests.faults --seed $(or $(SEED),1)
	@$(PY) -m tests.simulation --seed $(or $(SEED),1)
	@$(PY) -m tests.suite --whole tests/usecases/test_recovery.py tests/usecases/test_take_over.py tests/usecases/test_doubtful_starts.py tests/usecases/test_interrupted_commands.py tests/usecases/test_random_events.py -n 2 --dist load

# Faults of three managers and an etcd of three members, on from those in the record: MINUTES=10 of the next ones.
managers: setup
	@.ci/need-etcd
	@$(PY) -m tests.faults --only "three managers" --times 1 --jobs $(or $(JOBS),2) --minutes $(or $(MINUTES),60) --record tests/faults/three_managers.jsonl

# At least 100,000 damaged inputs to every decoder together; make fuzz SEED=7 damages them otherwise.
# Then the properties that make test checks with the same examples in every run, with others.
fuzz: setup
	@$(PY) -m tests.fuzz --seed $(or $(SEED),1)
	@$(PY) -m pytest tests -m hypothesis -n 2 --hypothesis-profile=search --hypothesis-seed=$(or $(SEED),1)

# 10,000 cycles of watch over simulated hosts and 200 over real ones that die and return: nothing may grow. Some minutes.
soak: setup
	@.ci/need-sshd
	@PATH="$$PATH:/usr/sbin:/sbin" $(PY) -m tests.soak

# The shipped experiment on hosts of its own: table, page and figures in runs/patrol. Some twenty minutes; REPETITIONS=1
# takes a third, REPETITIONS=10 is the evidence. Stopped at any point, the same command resumes.
experiment: setup
	@.ci/need-faults
	@PATH="$$PATH:/usr/sbin:/sbin" $(PY) -m tests.experiments.lab --repetitions $(or $(REPETITIONS),3)

# Every state of docs/model in several bounds, and traces of faults on real hosts against it: the tables of docs/model/README.md.
# Some twenty minutes; a short form runs in the suite.
model: setup
	@.ci/need-tlc
	@.ci/need-etcd
	@.ci/need-faults
	@PATH="$$PATH:/usr/sbin:/sbin" $(PY) -m tests.protocol --seed $(or $(SEED),1)

# The documentation site in .site, strictly: a dead link or a page outside of the navigation fails.
docs: setup
	@.venv/bin/zensical build --strict --clean -f .mkdocs.yml

# The container image, where a builder and a registry of base images can be reached, else .ci/base-image; make image BUILDER=docker.
BUILDER ?= podman
image:
	@$(BUILDER) build --file .ci/Containerfile --tag edgectl .

# Takes over runs/patrol as docs/experiment, and writes its tables and figures into docs/evaluation.md.
evaluation: setup
	@$(PY) -m tests.docs.evaluation

clean:
	rm -rf .site .venv .venv-3.* .venv-lowest .venv-ros2 .venv-cyclone .venv-engines .pytest_cache .mypy_cache .ruff_cache .hypothesis dist build
