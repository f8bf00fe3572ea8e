-- Why: with a hundred thousand jobs, lists by label or state, the quota of an upload and the metrics must not read every
-- job. Triggers keep the tables below equal to `jobs` and `sessions`, whichever statement changes those.

-- Lists of one state, newest first.
CREATE INDEX jobs_by_tenant_state ON jobs (tenant, state, seq);
-- Automatic removal reads the oldest ends first.
CREATE INDEX jobs_by_end ON jobs (finished_at) WHERE finished_at IS NOT NULL;

-- One row is one label of one job.
CREATE TABLE job_labels (
    tenant TEXT NOT NULL,
    key    TEXT NOT NULL,
    seq    INTEGER NOT NULL,                     -- `jobs.seq`
    value  TEXT NOT NULL,
    PRIMARY KEY (tenant, key, seq)
) STRICT, WITHOUT ROWID;
CREATE INDEX job_labels_by_value ON job_labels (tenant, key, value, seq);
INSERT INTO job_labels (tenant, key, seq, value)
    SELECT jobs.tenant, label.key, jobs.seq, label.value FROM jobs, json_each(jobs.labels) AS label;

CREATE TRIGGER jobs_labels_added AFTER INSERT ON jobs WHEN NEW.labels <> '{}'
BEGIN
    INSERT INTO job_labels (tenant, key, seq, value)
        SELECT NEW.tenant, label.key, NEW.seq, label.value FROM json_each(NEW.labels) AS label;
END;
CREATE TRIGGER jobs_labels_removed AFTER DELETE ON jobs WHEN OLD.labels <> '{}'
BEGIN
    DELETE FROM job_labels
        WHERE tenant = OLD.tenant AND seq = OLD.seq AND key IN (SELECT label.key FROM json_each(OLD.labels) AS label);
END;

-- One row is the number of jobs of one tenant in one state.
CREATE TABLE job_counts (
    tenant TEXT NOT NULL,
    state  TEXT NOT NULL,
    jobs   INTEGER NOT NULL,
    PRIMARY KEY (tenant, state)
) STRICT, WITHOUT ROWID;
INSERT INTO job_counts (tenant, state, jobs) SELECT tenant, state, count(*) FROM jobs GROUP BY tenant, state;

CREATE TRIGGER jobs_counted AFTER INSERT ON jobs
BEGIN
    INSERT INTO job_counts (tenant, state, jobs) VALUES (NEW.tenant, NEW.state, 1)
        ON CONFLICT (tenant, state) DO UPDATE SET jobs = jobs + 1;
END;
CREATE TRIGGER jobs_recounted AFTER UPDATE OF state ON jobs WHEN NEW.state <> OLD.state
BEGIN
    UPDATE job_counts SET jobs = jobs - 1 WHERE tenant = OLD.tenant AND state = OLD.state;
    INSERT INTO job_counts (tenant, state, jobs) VALUES (NEW.tenant, NEW.state, 1)
        ON CONFLICT (tenant, state) DO UPDATE SET jobs = jobs + 1;
END;
CREATE TRIGGER jobs_uncounted AFTER DELETE ON jobs
BEGIN
    UPDATE job_counts SET jobs = jobs - 1 WHERE tenant = OLD.tenant AND state = OLD.state;
END;

-- Bytes of the tenant's uploads and published results, which its quota bounds.
ALTER TABLE tenants ADD COLUMN stored_bytes INTEGER NOT NULL DEFAULT 0;
INSERT INTO tenants (name) SELECT tenant FROM sessions WHERE true UNION SELECT tenant FROM jobs WHERE true
    ON CONFLICT (name) DO NOTHING;
UPDATE tenants SET stored_bytes = (SELECT coalesce(sum(bytes), 0) FROM sessions WHERE sessions.tenant = tenants.name)
                                + (SELECT coalesce(sum(result_bytes), 0) FROM jobs WHERE jobs.tenant = tenants.name);

CREATE TRIGGER sessions_stored AFTER INSERT ON sessions
BEGIN
    INSERT INTO tenants (name, stored_bytes) VALUES (NEW.tenant, NEW.bytes)
        ON CONFLICT (name) DO UPDATE SET stored_bytes = stored_bytes + NEW.bytes;
END;
CREATE TRIGGER sessions_released AFTER DELETE ON sessions
BEGIN
    UPDATE tenants SET stored_bytes = stored_bytes - OLD.bytes WHERE name = OLD.tenant;
END;
CREATE TRIGGER results_inserted AFTER INSERT ON jobs WHEN NEW.result_bytes <> 0
BEGIN
    INSERT INTO tenants (name, stored_bytes) VALUES (NEW.tenant, NEW.result_bytes)
        ON CONFLICT (name) DO UPDATE SET stored_bytes = stored_bytes + NEW.result_bytes;
END;
CREATE TRIGGER results_stored AFTER UPDATE OF result_bytes ON jobs WHEN NEW.result_bytes <> OLD.result_bytes
BEGIN
    UPDATE tenants SET stored_bytes = stored_bytes + NEW.result_bytes - OLD.result_bytes WHERE name = NEW.tenant;
END;
CREATE TRIGGER results_released AFTER DELETE ON jobs WHEN OLD.result_bytes <> 0
BEGIN
    UPDATE tenants SET stored_bytes = stored_bytes - OLD.result_bytes WHERE name = OLD.tenant;
END;
