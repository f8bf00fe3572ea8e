-- Why: a client that was promised a call gets it although the service, the network or the receiver fails in between. The
-- row is written in the transaction that ends the job, so neither is there without the other.

ALTER TABLE jobs ADD COLUMN webhook TEXT;        -- URL to be called at the end

-- One row is one event for one receiver, however many tries it takes.
CREATE TABLE webhook_deliveries (
    seq         INTEGER PRIMARY KEY AUTOINCREMENT,
    id          TEXT NOT NULL UNIQUE,            -- the `webhook-id` that the receiver tells repetitions by
    tenant      TEXT NOT NULL,
    job_id      TEXT NOT NULL REFERENCES jobs (id) ON DELETE CASCADE,
    event       TEXT NOT NULL,                   -- job.succeeded, job.failed, job.canceled, job.dead
    url         TEXT NOT NULL,
    state       TEXT NOT NULL CHECK (state IN ('waiting', 'delivered', 'failed')),
    tries       INTEGER NOT NULL DEFAULT 0,
    next_try_at INTEGER NOT NULL DEFAULT 0,      -- Unix seconds; a clock set back makes the delivery due at once
    last_status INTEGER,                         -- HTTP status of the last try
    last_error  TEXT,                            -- why the last try failed
    created_at  TEXT NOT NULL,
    updated_at  TEXT NOT NULL
) STRICT;
CREATE INDEX webhook_deliveries_waiting ON webhook_deliveries (state, next_try_at);
CREATE INDEX webhook_deliveries_by_job ON webhook_deliveries (job_id, seq);

-- Whatever ends a job (its child, a cancel, the next start), its receiver is told.
CREATE TRIGGER jobs_ends_are_told AFTER UPDATE OF state ON jobs
WHEN NEW.webhook IS NOT NULL AND NEW.state <> OLD.state AND NEW.state IN ('succeeded', 'failed', 'canceled', 'dead')
BEGIN
    INSERT INTO webhook_deliveries (id, tenant, job_id, event, url, state, created_at, updated_at)
    VALUES ('delivery_' || lower(hex(randomblob(16))), NEW.tenant, NEW.id, 'job.' || NEW.state, NEW.webhook, 'waiting',
            strftime('%Y-%m-%dT%H:%M:%fZ', 'now'), strftime('%Y-%m-%dT%H:%M:%fZ', 'now'));
END;
