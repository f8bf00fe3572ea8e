-- Why: whatever the service has acknowledged must survive its death. These tables are the truth; large files lie beside
-- the database (`sessions/`, `results/`) and are named by rows. Times are UTC in RFC 3339 with milliseconds, written by
-- SQLite's own clock; nothing is ordered by them, `seq` is.

-- One row is one upload that was read and found valid. The same bytes are the same session, hence `sha256` is unique.
CREATE TABLE sessions (
    seq                 INTEGER PRIMARY KEY AUTOINCREMENT,
    id                  TEXT NOT NULL UNIQUE,    -- names the bytes in `sessions/`, too
    sha256              TEXT NOT NULL UNIQUE,
    bytes               INTEGER NOT NULL,
    name                TEXT NOT NULL,
    cameras             TEXT NOT NULL,           -- JSON list of {id, has_extrinsics}, in the session's order
    n_frames            INTEGER NOT NULL,
    people_max          INTEGER NOT NULL,        -- most detections in one image
    keypoint_convention TEXT NOT NULL,
    format              TEXT NOT NULL,
    warnings            TEXT NOT NULL,           -- JSON list of sentences
    created_at          TEXT NOT NULL
) STRICT;

-- One row is one job, from its acceptance on. `fence` counts the claims: whoever reports for an older claim changes
-- nothing. `deaths` counts only deaths of the job's own child process, never those of the service. `boot` names the
-- service process that runs the job now. `session_id` is no foreign key: a finished job outlives its session.
CREATE TABLE jobs (
    seq            INTEGER PRIMARY KEY AUTOINCREMENT,
    id             TEXT NOT NULL UNIQUE,
    session_id     TEXT NOT NULL,
    options        TEXT NOT NULL,                -- JSON, every option with its value
    labels         TEXT NOT NULL,                -- JSON object of strings
    priority       INTEGER NOT NULL,             -- higher runs first
    state          TEXT NOT NULL CHECK (state IN ('queued', 'running', 'canceling', 'succeeded', 'failed', 'canceled', 'dead')),
    version        INTEGER NOT NULL DEFAULT 1,   -- grows with every change; the ETag
    fence          INTEGER NOT NULL DEFAULT 0,
    attempt        INTEGER NOT NULL DEFAULT 0,
    deaths         INTEGER NOT NULL DEFAULT 0,
    boot           TEXT,
    stage          TEXT NOT NULL DEFAULT '',
    stage_index    INTEGER NOT NULL DEFAULT 0,
    stage_count    INTEGER NOT NULL DEFAULT 0,
    fraction       REAL NOT NULL DEFAULT 0.0,    -- never falls
    message        TEXT NOT NULL DEFAULT '',
    eta_s          REAL,
    stage_seconds  TEXT NOT NULL DEFAULT '{}',   -- JSON, wall seconds by stage of the last attempt
    error          TEXT,                         -- JSON: code, detail, place and remedy
    result_fence   INTEGER,                      -- results/<id>/<result_fence>/ holds the result
    solver_version TEXT,
    created_at     TEXT NOT NULL,
    started_at     TEXT,
    finished_at    TEXT,
    CHECK ((state IN ('running', 'canceling')) = (boot IS NOT NULL)),
    CHECK ((state IN ('succeeded', 'failed', 'canceled', 'dead')) = (finished_at IS NOT NULL)),
    CHECK ((state IN ('failed', 'dead')) = (error IS NOT NULL)),
    CHECK ((state = 'succeeded') = (result_fence IS NOT NULL))
) STRICT;

-- The claim reads the first row of this index; recovery and "is this session in use" read it too.
CREATE INDEX jobs_by_state ON jobs (state, priority DESC, seq);
CREATE INDEX jobs_by_session ON jobs (session_id);

-- A final state is final, whatever a later release's code believes.
CREATE TRIGGER jobs_final_states_stay BEFORE UPDATE OF state ON jobs
WHEN OLD.state IN ('succeeded', 'failed', 'canceled', 'dead') AND NEW.state <> OLD.state
BEGIN
    SELECT RAISE(ABORT, 'a final state never changes');
END;

-- One row is one Idempotency-Key and what was asked under it. It stays when the job is deleted: a late repetition of the
-- request must not bring the job back.
CREATE TABLE idempotency (
    key         TEXT PRIMARY KEY,
    fingerprint TEXT NOT NULL,                   -- SHA-256 of the canonical request
    job_id      TEXT NOT NULL,
    created_at  TEXT NOT NULL
) STRICT, WITHOUT ROWID;
