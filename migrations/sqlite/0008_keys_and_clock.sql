-- Why: a request repeated under its Idempotency-Key gives its job even after the session was deleted, and removal by age
-- must not follow a clock that jumped while the service was stopped.

-- The session of the first request; null in rows of earlier releases whose job or session was deleted.
ALTER TABLE idempotency ADD COLUMN session_id TEXT;
ALTER TABLE idempotency ADD COLUMN session_sha256 TEXT;
UPDATE idempotency SET session_id = (SELECT jobs.session_id FROM jobs WHERE jobs.id = idempotency.job_id);
UPDATE idempotency
    SET session_sha256 = (SELECT sessions.sha256 FROM sessions WHERE sessions.id = idempotency.session_id);
CREATE INDEX idempotency_by_age ON idempotency (created_at);

-- The only row is the wall clock as the service has seen it.
CREATE TABLE clock (
    id        INTEGER PRIMARY KEY CHECK (id = 1),
    seen_at   INTEGER NOT NULL,                  -- latest plausible time, Unix seconds
    suspect_s INTEGER NOT NULL DEFAULT 0         -- seconds that the service has run with an implausible clock
) STRICT;
INSERT INTO clock (id, seen_at)
    SELECT 1, coalesce((SELECT unixepoch(created_at) FROM jobs ORDER BY seq DESC LIMIT 1), unixepoch('now'));
