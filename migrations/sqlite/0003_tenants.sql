-- Why: several studios or departments share one service and must not know of each other. Every session and job belongs to
-- one tenant; a service without keys serves the one tenant `default`.

-- One row is one tenant that has ever asked for work.
CREATE TABLE tenants (
    name           TEXT PRIMARY KEY,
    turn           INTEGER NOT NULL DEFAULT 0,   -- when it was last given a worker: the lowest is served next
    webhook_secret TEXT                          -- signs its webhooks; made when it is first asked for
) STRICT, WITHOUT ROWID;

-- One row is one API key. The secret itself is told once and stored nowhere.
CREATE TABLE api_keys (
    id         TEXT PRIMARY KEY,                 -- the public half of the key
    tenant     TEXT NOT NULL,
    name       TEXT NOT NULL,                    -- for the operator to read
    scopes     TEXT NOT NULL,                    -- JSON list of `read`, `write`, `metrics`
    digest     TEXT NOT NULL,                    -- SHA-256 of the secret half, 256 random bits
    created_at TEXT NOT NULL,
    revoked_at TEXT
) STRICT, WITHOUT ROWID;

-- The same bytes are the same session of one tenant, and two sessions of two.
CREATE TABLE tenant_sessions (
    seq                 INTEGER PRIMARY KEY AUTOINCREMENT,
    id                  TEXT NOT NULL UNIQUE,
    tenant              TEXT NOT NULL,
    sha256              TEXT NOT NULL,
    bytes               INTEGER NOT NULL,
    name                TEXT NOT NULL,
    cameras             TEXT NOT NULL,           -- JSON list of {id, has_extrinsics}, in the session's order
    n_frames            INTEGER NOT NULL,
    people_max          INTEGER NOT NULL,
    keypoint_convention TEXT NOT NULL,
    format              TEXT NOT NULL,
    warnings            TEXT NOT NULL,           -- JSON list of sentences
    created_at          TEXT NOT NULL,
    UNIQUE (tenant, sha256)
) STRICT;
INSERT INTO tenant_sessions
    SELECT seq, id, 'default', sha256, bytes, name, cameras, n_frames, people_max, keypoint_convention, format, warnings,
           created_at
    FROM sessions;
DROP TABLE sessions;
ALTER TABLE tenant_sessions RENAME TO sessions;
CREATE INDEX sessions_by_tenant ON sessions (tenant, seq);

ALTER TABLE jobs ADD COLUMN tenant TEXT NOT NULL DEFAULT 'default';
ALTER TABLE jobs ADD COLUMN result_bytes INTEGER NOT NULL DEFAULT 0; -- size of all published files
UPDATE jobs SET result_bytes = (SELECT coalesce(sum(bytes), 0) FROM artifacts WHERE artifacts.job_id = jobs.id)
    WHERE state = 'succeeded';
INSERT INTO tenants (name) VALUES ('default');

-- The claim takes the tenant whose turn it is, and of its jobs the first row of this index.
DROP INDEX jobs_by_state;
CREATE INDEX jobs_by_state ON jobs (state, tenant, priority DESC, seq);
CREATE INDEX jobs_by_tenant ON jobs (tenant, seq);

-- One tenant's keys mean nothing to another.
CREATE TABLE tenant_idempotency (
    tenant      TEXT NOT NULL,
    key         TEXT NOT NULL,
    fingerprint TEXT NOT NULL,                   -- SHA-256 of the canonical request
    job_id      TEXT NOT NULL,
    created_at  TEXT NOT NULL,
    PRIMARY KEY (tenant, key)
) STRICT, WITHOUT ROWID;
INSERT INTO tenant_idempotency SELECT 'default', key, fingerprint, job_id, created_at FROM idempotency;
DROP TABLE idempotency;
ALTER TABLE tenant_idempotency RENAME TO idempotency;
