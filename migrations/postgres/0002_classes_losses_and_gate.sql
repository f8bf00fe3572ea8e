-- Why: machines differ in memory, a job can take its machine with it, and releases are mixed while a service is upgraded.
-- Only additions, so that nodes of the release before go on working while this runs; `docs/operating.md` states that rule.

-- The oldest release that may still use these tables. A migration that takes something away raises it, so that an older node ends with
-- one line where it would damage rows.
CREATE TABLE gate (
    id             BIGINT PRIMARY KEY CHECK (id = 1),
    oldest_release TEXT NOT NULL
);
INSERT INTO gate (id, oldest_release) VALUES (1, '0.1.0');

-- `class`: how much memory the job needs, from the size of its session, and more after it ran out of memory. `needs`: the level of
-- options that a worker must know. `losses`: how often the leader put the job back because its worker fell silent before a further
-- stage was finished; `lost_stage`: the furthest stage in which that happened.
ALTER TABLE jobs ADD COLUMN class BIGINT NOT NULL DEFAULT 0 CHECK (class BETWEEN 0 AND 3);
ALTER TABLE jobs ADD COLUMN needs BIGINT NOT NULL DEFAULT 0;
ALTER TABLE jobs ADD COLUMN losses BIGINT NOT NULL DEFAULT 0;
ALTER TABLE jobs ADD COLUMN lost_stage BIGINT NOT NULL DEFAULT -1;

-- A claim looks up the first waiting job of a tenant in each class that its worker has memory for.
CREATE INDEX jobs_waiting_by_class ON jobs (tenant, class, priority DESC, seq) INCLUDE (needs) WHERE state = 'queued';
DROP INDEX jobs_waiting;
-- The figures read the oldest waiting job of all tenants.
CREATE INDEX jobs_waiting_oldest ON jobs (seq) WHERE state = 'queued';
DROP INDEX jobs_waiting_by_age;

-- Jobs without a final state by class: how many workers of each class are wanted.
ALTER TABLE tenants ADD COLUMN n_wanted_0 BIGINT NOT NULL DEFAULT 0;
ALTER TABLE tenants ADD COLUMN n_wanted_1 BIGINT NOT NULL DEFAULT 0;
ALTER TABLE tenants ADD COLUMN n_wanted_2 BIGINT NOT NULL DEFAULT 0;
ALTER TABLE tenants ADD COLUMN n_wanted_3 BIGINT NOT NULL DEFAULT 0;
UPDATE tenants SET n_wanted_0 = (SELECT count(*) FROM jobs WHERE tenant = name AND state IN ('queued', 'running', 'canceling'));

CREATE FUNCTION is_open(job_state TEXT) RETURNS INT LANGUAGE sql IMMUTABLE AS $$
    SELECT (job_state IN ('queued', 'running', 'canceling'))::int
$$;

CREATE FUNCTION add_job(tenant_name TEXT, job_state TEXT, job_class BIGINT, n BIGINT, bytes BIGINT) RETURNS VOID LANGUAGE sql AS $$
    UPDATE tenants SET n_queued = n_queued + CASE job_state WHEN 'queued' THEN n ELSE 0 END,
                       n_running = n_running + CASE job_state WHEN 'running' THEN n ELSE 0 END,
                       n_canceling = n_canceling + CASE job_state WHEN 'canceling' THEN n ELSE 0 END,
                       n_succeeded = n_succeeded + CASE job_state WHEN 'succeeded' THEN n ELSE 0 END,
                       n_failed = n_failed + CASE job_state WHEN 'failed' THEN n ELSE 0 END,
                       n_canceled = n_canceled + CASE job_state WHEN 'canceled' THEN n ELSE 0 END,
                       n_dead = n_dead + CASE job_state WHEN 'dead' THEN n ELSE 0 END,
                       n_wanted_0 = n_wanted_0 + CASE job_class WHEN 0 THEN n * is_open(job_state) ELSE 0 END,
                       n_wanted_1 = n_wanted_1 + CASE job_class WHEN 1 THEN n * is_open(job_state) ELSE 0 END,
                       n_wanted_2 = n_wanted_2 + CASE job_class WHEN 2 THEN n * is_open(job_state) ELSE 0 END,
                       n_wanted_3 = n_wanted_3 + CASE job_class WHEN 3 THEN n * is_open(job_state) ELSE 0 END,
                       stored_bytes = stored_bytes + bytes
        WHERE name = tenant_name
$$;

CREATE OR REPLACE FUNCTION after_insert_of_job() RETURNS TRIGGER LANGUAGE plpgsql AS $$
BEGIN
    INSERT INTO tenants (name) VALUES (NEW.tenant) ON CONFLICT (name) DO NOTHING;
    PERFORM add_job(NEW.tenant, NEW.state, NEW.class, 1, NEW.result_bytes);
    IF NEW.labels <> '{}' THEN
        INSERT INTO job_labels (tenant, key, seq, value)
            SELECT NEW.tenant, label.key, NEW.seq, label.value FROM json_each(NEW.labels) AS label;
    END IF;
    RETURN NULL;
END $$;

-- The class changes only together with the state.
CREATE OR REPLACE FUNCTION after_state_of_job() RETURNS TRIGGER LANGUAGE plpgsql AS $$
BEGIN
    UPDATE tenants SET
        n_queued = n_queued + (NEW.state = 'queued')::int - (OLD.state = 'queued')::int,
        n_running = n_running + (NEW.state = 'running')::int - (OLD.state = 'running')::int,
        n_canceling = n_canceling + (NEW.state = 'canceling')::int - (OLD.state = 'canceling')::int,
        n_succeeded = n_succeeded + (NEW.state = 'succeeded')::int,
        n_failed = n_failed + (NEW.state = 'failed')::int,
        n_canceled = n_canceled + (NEW.state = 'canceled')::int,
        n_dead = n_dead + (NEW.state = 'dead')::int,
        n_wanted_0 = n_wanted_0 + (NEW.class = 0)::int * is_open(NEW.state) - (OLD.class = 0)::int * is_open(OLD.state),
        n_wanted_1 = n_wanted_1 + (NEW.class = 1)::int * is_open(NEW.state) - (OLD.class = 1)::int * is_open(OLD.state),
        n_wanted_2 = n_wanted_2 + (NEW.class = 2)::int * is_open(NEW.state) - (OLD.class = 2)::int * is_open(OLD.state),
        n_wanted_3 = n_wanted_3 + (NEW.class = 3)::int * is_open(NEW.state) - (OLD.class = 3)::int * is_open(OLD.state)
        WHERE name = NEW.tenant;
    IF NEW.webhook IS NOT NULL AND NEW.state IN ('succeeded', 'failed', 'canceled', 'dead') THEN
        INSERT INTO webhook_deliveries (id, tenant, job_id, event, url, state, created_at, updated_at)
        VALUES ('delivery_' || replace(gen_random_uuid()::text, '-', ''), NEW.tenant, NEW.id, 'job.' || NEW.state, NEW.webhook,
                'waiting', strftime('', 'now'), strftime('', 'now'));
    END IF;
    RETURN NULL;
END $$;

CREATE OR REPLACE FUNCTION after_delete_of_job() RETURNS TRIGGER LANGUAGE plpgsql AS $$
BEGIN
    PERFORM add_job(OLD.tenant, OLD.state, OLD.class, -1, -OLD.result_bytes);
    IF OLD.labels <> '{}' THEN
        DELETE FROM job_labels
            WHERE tenant = OLD.tenant AND seq = OLD.seq AND key IN (SELECT label.key FROM json_each(OLD.labels) AS label);
    END IF;
    RETURN NULL;
END $$;
