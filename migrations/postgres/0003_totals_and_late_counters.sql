-- Why: with ten thousand tenants, adding up their counters took 10 to 20 ms of each acceptance and of the figures; and the end of a job
-- held the counters of its tenant from its last statement to its commit, a round trip in which every other change of the tenant waited.
-- Only additions, so that nodes of the release before go on working while this runs; `docs/operating.md` states that rule.

-- The counters of all tenants together are the sums over these rows. A connection adds to the row of its number, so that two seldom meet in
-- one; a row alone may therefore be negative. Almost empty pages keep the updates in place.
CREATE TABLE job_totals (
    shard       BIGINT PRIMARY KEY,
    n_queued    BIGINT NOT NULL DEFAULT 0,
    n_running   BIGINT NOT NULL DEFAULT 0,
    n_canceling BIGINT NOT NULL DEFAULT 0,
    n_succeeded BIGINT NOT NULL DEFAULT 0,
    n_failed    BIGINT NOT NULL DEFAULT 0,
    n_canceled  BIGINT NOT NULL DEFAULT 0,
    n_dead      BIGINT NOT NULL DEFAULT 0,
    n_wanted_0  BIGINT NOT NULL DEFAULT 0,
    n_wanted_1  BIGINT NOT NULL DEFAULT 0,
    n_wanted_2  BIGINT NOT NULL DEFAULT 0,
    n_wanted_3  BIGINT NOT NULL DEFAULT 0
) WITH (fillfactor = 10);
INSERT INTO job_totals (shard) SELECT shard FROM generate_series(0, 63) AS shard;

CREATE FUNCTION own_shard() RETURNS BIGINT LANGUAGE sql STABLE AS $$ SELECT CAST(pg_backend_pid() % 64 AS BIGINT) $$;

-- Sets the totals to the sums over the tenants, after rows were written without triggers.
CREATE FUNCTION add_up_totals() RETURNS VOID LANGUAGE sql AS $$
    UPDATE job_totals SET (n_queued, n_running, n_canceling, n_succeeded, n_failed, n_canceled, n_dead,
                           n_wanted_0, n_wanted_1, n_wanted_2, n_wanted_3) =
        (SELECT coalesce(sum(n_queued), 0), coalesce(sum(n_running), 0), coalesce(sum(n_canceling), 0), coalesce(sum(n_succeeded), 0),
                coalesce(sum(n_failed), 0), coalesce(sum(n_canceled), 0), coalesce(sum(n_dead), 0), coalesce(sum(n_wanted_0), 0),
                coalesce(sum(n_wanted_1), 0), coalesce(sum(n_wanted_2), 0), coalesce(sum(n_wanted_3), 0)
         FROM tenants WHERE shard = 0)
$$;

-- Jobs that change from here on wait for the end of this migration, and are counted then.
LOCK TABLE jobs IN SHARE ROW EXCLUSIVE MODE;
SELECT add_up_totals();

-- By how much the number of jobs in a state, and of those without a final state in a class, changes with a job. `before` is missing for a
-- job that is accepted, `after` for one that is deleted.
CREATE FUNCTION step(before TEXT, after TEXT, counted TEXT) RETURNS INT LANGUAGE sql IMMUTABLE AS $$
    SELECT coalesce((after = counted)::int, 0) - coalesce((before = counted)::int, 0)
$$;
CREATE FUNCTION step_wanted(before TEXT, class_before BIGINT, after TEXT, class_after BIGINT, counted INT) RETURNS INT LANGUAGE sql IMMUTABLE AS $$
    SELECT coalesce((class_after = counted)::int * is_open(after), 0) - coalesce((class_before = counted)::int * is_open(before), 0)
$$;

-- PL/pgSQL keeps the plans of its statements; a function in SQL is planned with each job.
CREATE FUNCTION count_job(tenant_name TEXT, before TEXT, class_before BIGINT, after TEXT, class_after BIGINT, bytes BIGINT) RETURNS VOID
LANGUAGE plpgsql AS $$
BEGIN
    UPDATE tenants SET
        n_queued = n_queued + step(before, after, 'queued'),
        n_running = n_running + step(before, after, 'running'),
        n_canceling = n_canceling + step(before, after, 'canceling'),
        n_succeeded = n_succeeded + step(before, after, 'succeeded'),
        n_failed = n_failed + step(before, after, 'failed'),
        n_canceled = n_canceled + step(before, after, 'canceled'),
        n_dead = n_dead + step(before, after, 'dead'),
        n_wanted_0 = n_wanted_0 + step_wanted(before, class_before, after, class_after, 0),
        n_wanted_1 = n_wanted_1 + step_wanted(before, class_before, after, class_after, 1),
        n_wanted_2 = n_wanted_2 + step_wanted(before, class_before, after, class_after, 2),
        n_wanted_3 = n_wanted_3 + step_wanted(before, class_before, after, class_after, 3),
        stored_bytes = stored_bytes + bytes
        WHERE name = tenant_name;
    UPDATE job_totals SET
        n_queued = n_queued + step(before, after, 'queued'),
        n_running = n_running + step(before, after, 'running'),
        n_canceling = n_canceling + step(before, after, 'canceling'),
        n_succeeded = n_succeeded + step(before, after, 'succeeded'),
        n_failed = n_failed + step(before, after, 'failed'),
        n_canceled = n_canceled + step(before, after, 'canceled'),
        n_dead = n_dead + step(before, after, 'dead'),
        n_wanted_0 = n_wanted_0 + step_wanted(before, class_before, after, class_after, 0),
        n_wanted_1 = n_wanted_1 + step_wanted(before, class_before, after, class_after, 1),
        n_wanted_2 = n_wanted_2 + step_wanted(before, class_before, after, class_after, 2),
        n_wanted_3 = n_wanted_3 + step_wanted(before, class_before, after, class_after, 3)
        WHERE shard = own_shard();
END $$;

CREATE OR REPLACE FUNCTION after_insert_of_job() RETURNS TRIGGER LANGUAGE plpgsql AS $$
BEGIN
    INSERT INTO tenants (name) VALUES (NEW.tenant) ON CONFLICT (name) DO NOTHING;
    PERFORM count_job(NEW.tenant, NULL, NULL, NEW.state, NEW.class, NEW.result_bytes);
    IF NEW.labels <> '{}' THEN
        INSERT INTO job_labels (tenant, key, seq, value)
            SELECT NEW.tenant, label.key, NEW.seq, label.value FROM json_each(NEW.labels) AS label;
    END IF;
    RETURN NULL;
END $$;

CREATE OR REPLACE FUNCTION after_delete_of_job() RETURNS TRIGGER LANGUAGE plpgsql AS $$
BEGIN
    PERFORM count_job(OLD.tenant, OLD.state, OLD.class, NULL, NULL, -OLD.result_bytes);
    IF OLD.labels <> '{}' THEN
        DELETE FROM job_labels
            WHERE tenant = OLD.tenant AND seq = OLD.seq AND key IN (SELECT label.key FROM json_each(OLD.labels) AS label);
    END IF;
    RETURN NULL;
END $$;
DROP FUNCTION add_job;

-- The receiver of a job that has ended is called, whatever ended it.
CREATE OR REPLACE FUNCTION after_state_of_job() RETURNS TRIGGER LANGUAGE plpgsql AS $$
BEGIN
    INSERT INTO webhook_deliveries (id, tenant, job_id, event, url, state, created_at, updated_at)
    VALUES ('delivery_' || replace(gen_random_uuid()::text, '-', ''), NEW.tenant, NEW.id, 'job.' || NEW.state, NEW.webhook,
            'waiting', strftime('', 'now'), strftime('', 'now'));
    RETURN NULL;
END $$;
DROP TRIGGER jobs_recounted ON jobs;
CREATE TRIGGER jobs_ended AFTER UPDATE OF state ON jobs FOR EACH ROW
    WHEN (NEW.state <> OLD.state AND NEW.webhook IS NOT NULL AND NEW.state IN ('succeeded', 'failed', 'canceled', 'dead'))
    EXECUTE FUNCTION after_state_of_job();

-- Counters change within the commit. The class changes only together with the state.
CREATE FUNCTION count_state_of_job() RETURNS TRIGGER LANGUAGE plpgsql AS $$
BEGIN
    PERFORM count_job(NEW.tenant, OLD.state, OLD.class, NEW.state, NEW.class, 0);
    RETURN NULL;
END $$;
CREATE CONSTRAINT TRIGGER jobs_counted AFTER UPDATE OF state ON jobs DEFERRABLE INITIALLY DEFERRED FOR EACH ROW
    WHEN (NEW.state <> OLD.state) EXECUTE FUNCTION count_state_of_job();

DROP TRIGGER results_stored ON jobs;
CREATE CONSTRAINT TRIGGER results_stored AFTER UPDATE OF result_bytes ON jobs DEFERRABLE INITIALLY DEFERRED FOR EACH ROW
    WHEN (NEW.result_bytes <> OLD.result_bytes) EXECUTE FUNCTION after_bytes_of_job();
