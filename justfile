# Everything CI runs, and the long checks that CI runs in a short form. `just --list` shows all.

data := env("WANDLESS_TEST_DATA", "captures")
program := "target/release/wandless"

# Formatting, lints, spelling, tests with and without the service, documentation
ci:
    bash .ci/run

# Unit and integration tests
test *filter:
    cargo test --release {{filter}}

# The import rules and the language rules
rules:
    cargo test --release --test layering --test language

# Licences, advisories, sources of the dependencies (cargo install cargo-deny)
deny:
    cargo deny check

build:
    cargo build --release

# The program with named points at which it can be made to end
build-failpoints:
    cargo build --release --features failpoints,scale --target-dir target/failpoints

# Kernels, stages, end to end
bench *filter:
    cargo bench {{filter}}

# Random rigs: success, and how often the stated 95 % intervals hold
rigs count="200": build
    {{program}} bench rigs --count {{count}}

# Bodies of known shape: joints, statures, angles, metric scale
bodies count="20": build
    {{program}} bench bodies --count {{count}}

# The worth of each part on sessions with truth, given or simulated
ablation out *sessions: build
    {{program}} bench ablation {{sessions}} --out {{out}}

# The acceptance of the main job over HTTP, on captures with truth
acceptance score: build
    python3 checks/acceptance.py --data {{data}} --score {{score}}

# The service killed, stopped, damaged, abused and crowded
service: build build-failpoints
    for check in crashes stops safety sockets tenants hostile load described; do python3 checks/service/$check.py || exit 1; done

# Every check of the service on a program with the fault that it exists to find
selftest: build-failpoints
    python3 checks/service/selftest.py

# One reader of foreign bytes under seeded damage
fuzz target seconds="600":
    FUZZ_TARGET={{target}} FUZZ_SECONDS={{seconds}} cargo test --release --test fuzz -- --ignored --nocapture

# Every export opened by an independent reader
exports work: build
    checks/exports/run.sh {{program}} {{work}}

# The Python package against the program
python: build
    python3 -m venv target/python && target/python/bin/pip install --quiet -e 'clients/python[test]'
    cd clients/python && ../../target/python/bin/mypy && ../../target/python/bin/pytest -q

# Clients of two generators go the whole way of a job
clients work: build
    checks/clients/run.sh {{program}} {{work}}

# The viewer in a real browser, long form
viewer: build
    cd checks/viewer && npm ci && npm run check -- --long
