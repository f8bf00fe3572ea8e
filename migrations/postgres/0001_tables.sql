-- Why: services of several machines share their rows here. The tables are those of SQLite (`migrations/sqlite`), whose files say why
-- each is there and what a row means; this file says only what differs. Times are UTC in RFC 3339 with milliseconds, written by the
-- clock of this server; nothing is ordered by them, `seq` is, and no claim ends by them, `beat` decides.

-- The functions of SQLite that statements of both databases call.
CREATE FUNCTION strftime(format TEXT, at TEXT, modifier TEXT DEFAULT '0 days') RETURNS TEXT LANGUAGE sql VOLATILE AS $$
    SELECT to_char((CASE at WHEN 'now' THEN clock_timestamp() ELSE at::timestamptz END + modifier::interval)
                   AT TIME ZONE 'UTC', 'YYYY-MM-DD"T"HH24:MI:SS.MS"Z"')
$$;
CREATE FUNCTION unixepoch() RETURNS BIGINT LANGUAGE sql VOLATILE AS $$
    SELECT CAST(floor(extract(epoch FROM clock_timestamp())) AS BIGINT)
$$;
CREATE FUNCTION julianday(at TEXT) RETURNS DOUBLE PRECISION LANGUAGE sql VOLATILE AS $$
    SELECT CAST(extract(epoch FROM CASE at WHEN 'now' THEN clock_timestamp() ELSE at::timestamptz END) AS DOUBLE PRECISION)
           / 86400.0 + 2440587.5
$$;
-- Values of a JSON list of texts, and of a JSON object of texts.
CREATE FUNCTION json_each(document TEXT) RETURNS TABLE (key TEXT, value TEXT) LANGUAGE sql IMMUTABLE AS $$
    SELECT (place - 1)::text, item FROM jsonb_array_elements_text(CASE jsonb_typeof(document::jsonb) WHEN 'array'
        THEN document::jsonb ELSE '[]'::jsonb END) WITH ORDINALITY AS list (item, place)
    UNION ALL
    SELECT pair.key, pair.value FROM jsonb_each_text(CASE jsonb_typeof(document::jsonb) WHEN 'object'
        THEN document::jsonb ELSE '{}'::jsonb END) AS pair
$$;

-- Counters and bytes change with every job: free space on the page keeps the updates in place.
CREATE TABLE tenants (
    name                    TEXT COLLATE "C" PRIMARY KEY,
    turn                    BIGINT NOT NULL DEFAULT 0,
    webhook_secret          TEXT,
    previous_webhook_secret TEXT,
    webhook_secret_set_at   BIGINT,
    stored_bytes            BIGINT NOT NULL DEFAULT 0,
    n_queued                BIGINT NOT NULL DEFAULT 0,
    n_running               BIGINT NOT NULL DEFAULT 0,
    n_canceling             BIGINT NOT NULL DEFAULT 0,
    n_succeeded             BIGINT NOT NULL DEFAULT 0,
    n_failed                BIGINT NOT NULL DEFAULT 0,
    n_canceled              BIGINT NOT NULL DEFAULT 0,
    n_dead                  BIGINT NOT NULL DEFAULT 0
) WITH (fillfactor = 50, autovacuum_vacuum_scale_factor = 0.02);
INSERT INTO tenants (name) VALUES ('default');
CREATE INDEX tenants_waiting ON tenants (turn, name) INCLUDE (n_queued) WHERE n_queued > 0;
-- Turns come from here: a maximum would be read and written by two claims at once.
CREATE SEQUENCE turns;

CREATE TABLE api_keys (
    id         TEXT PRIMARY KEY,
    tenant     TEXT NOT NULL,
    name       TEXT NOT NULL,
    scopes     TEXT NOT NULL,
    digest     TEXT NOT NULL,
    created_at TEXT COLLATE "C" NOT NULL,
    revoked_at TEXT
);

CREATE TABLE sessions (
    seq                 BIGINT GENERATED ALWAYS AS IDENTITY PRIMARY KEY,
    id                  TEXT COLLATE "C" NOT NULL UNIQUE,
    tenant              TEXT NOT NULL,
    sha256              TEXT NOT NULL,
    bytes               BIGINT NOT NULL,
    name                TEXT NOT NULL,
    cameras             TEXT NOT NULL,
    n_frames            BIGINT NOT NULL,
    people_max          BIGINT NOT NULL,
    keypoint_convention TEXT NOT NULL,
    format              TEXT NOT NULL,
    warnings            TEXT NOT NULL,
    created_at          TEXT COLLATE "C" NOT NULL,
    UNIQUE (tenant, sha256)
);
CREATE INDEX sessions_by_tenant ON sessions (tenant, seq);

-- `beat` grows while the worker of a claim is alive; the leader puts back a claim whose beat stands still.
CREATE TABLE jobs (
    seq            BIGINT GENERATED ALWAYS AS IDENTITY PRIMARY KEY,
    id             TEXT COLLATE "C" NOT NULL UNIQUE,
    tenant         TEXT COLLATE "C" NOT NULL DEFAULT 'default',
    session_id     TEXT NOT NULL,
    options        TEXT NOT NULL,
    labels         TEXT NOT NULL,
    priority       BIGINT NOT NULL,
    state          TEXT NOT NULL CHECK (state IN ('queued', 'running', 'canceling', 'succeeded', 'failed', 'canceled', 'dead')),
    version        BIGINT NOT NULL DEFAULT 1,
    fence          BIGINT NOT NULL DEFAULT 0,
    beat           BIGINT NOT NULL DEFAULT 0,
    attempt        BIGINT NOT NULL DEFAULT 0,
    crashes        BIGINT NOT NULL DEFAULT 0,
    boot           TEXT,
    stage          TEXT NOT NULL DEFAULT '',
    stage_index    BIGINT NOT NULL DEFAULT 0,
    stage_count    BIGINT NOT NULL DEFAULT 0,
    fraction       DOUBLE PRECISION NOT NULL DEFAULT 0.0,
    message        TEXT NOT NULL DEFAULT '',
    eta_s          DOUBLE PRECISION,
    stage_seconds  TEXT NOT NULL DEFAULT '{}',
    error          TEXT,
    result_fence   BIGINT,
    result_bytes   BIGINT NOT NULL DEFAULT 0,
    solver_version TEXT,
    webhook        TEXT,
    request_id     TEXT,
    key_id         TEXT,
    created_at     TEXT COLLATE "C" NOT NULL,
    started_at     TEXT,
    finished_at    TEXT COLLATE "C",
    CHECK ((state IN ('running', 'canceling')) = (boot IS NOT NULL)),
    CHECK ((state IN ('succeeded', 'failed', 'canceled', 'dead')) = (finished_at IS NOT NULL)),
    CHECK ((state IN ('failed', 'dead')) = (error IS NOT NULL)),
    CHECK ((state = 'succeeded') = (result_fence IS NOT NULL))
) WITH (fillfactor = 70, autovacuum_vacuum_scale_factor = 0.02);
-- Open jobs are few beside the ended ones: each has an index of its own, which beats do not touch.
CREATE INDEX jobs_waiting ON jobs (tenant, priority DESC, seq) WHERE state = 'queued';
CREATE INDEX jobs_waiting_by_age ON jobs (tenant, seq) WHERE state = 'queued';
CREATE INDEX jobs_at_work ON jobs (id) WHERE state IN ('running', 'canceling');
CREATE INDEX jobs_by_session ON jobs (session_id);
CREATE INDEX jobs_by_tenant ON jobs (tenant, seq);
CREATE INDEX jobs_by_tenant_state ON jobs (tenant, state, seq);
CREATE INDEX jobs_by_end ON jobs (finished_at) WHERE finished_at IS NOT NULL;

CREATE TABLE job_labels (
    tenant TEXT NOT NULL,
    key    TEXT NOT NULL,
    seq    BIGINT NOT NULL,
    value  TEXT NOT NULL,
    PRIMARY KEY (tenant, key, seq)
);
-- A label can be longer than an entry of an index: its digest finds it.
CREATE INDEX job_labels_by_value ON job_labels (tenant, key, md5(value), seq);

CREATE TABLE idempotency (
    tenant         TEXT NOT NULL,
    key            TEXT NOT NULL,
    fingerprint    TEXT NOT NULL,
    job_id         TEXT NOT NULL,
    session_id     TEXT,
    session_sha256 TEXT,
    created_at     TEXT COLLATE "C" NOT NULL,
    PRIMARY KEY (tenant, key)
);
CREATE INDEX idempotency_by_age ON idempotency (created_at);

CREATE TABLE artifacts (
    job_id     TEXT NOT NULL REFERENCES jobs (id) ON DELETE CASCADE,
    name       TEXT COLLATE "C" NOT NULL,
    media_type TEXT NOT NULL,
    bytes      BIGINT NOT NULL,
    sha256     TEXT NOT NULL,
    PRIMARY KEY (job_id, name)
);

CREATE TABLE verdicts (
    job_id              TEXT PRIMARY KEY REFERENCES jobs (id) ON DELETE CASCADE,
    verdict             TEXT NOT NULL CHECK (verdict IN ('pass', 'warn', 'reject')),
    reasons             TEXT NOT NULL,
    heldout_px          DOUBLE PRECISION,
    scale               DOUBLE PRECISION,
    scale_low95         DOUBLE PRECISION,
    scale_high95        DOUBLE PRECISION,
    rejected_detections DOUBLE PRECISION NOT NULL
);

CREATE TABLE stage_metrics (
    job_id      TEXT NOT NULL REFERENCES jobs (id) ON DELETE CASCADE,
    stage_index BIGINT NOT NULL,
    stage       TEXT NOT NULL,
    iterations  BIGINT NOT NULL,
    cost_before DOUBLE PRECISION,
    cost_after  DOUBLE PRECISION,
    termination TEXT NOT NULL,
    PRIMARY KEY (job_id, stage_index)
);

CREATE TABLE stage_metric_values (
    job_id      TEXT NOT NULL REFERENCES jobs (id) ON DELETE CASCADE,
    stage_index BIGINT NOT NULL,
    name        TEXT NOT NULL,
    value       DOUBLE PRECISION,
    PRIMARY KEY (job_id, stage_index, name)
);

CREATE TABLE camera_results (
    job_id                 TEXT NOT NULL REFERENCES jobs (id) ON DELETE CASCADE,
    camera_index           BIGINT NOT NULL,
    camera                 TEXT NOT NULL,
    status                 TEXT NOT NULL CHECK (status IN ('solved', 'unsolved')),
    n_observations         BIGINT NOT NULL,
    reprojection_mean_px   DOUBLE PRECISION,
    reprojection_median_px DOUBLE PRECISION,
    sigma_position_mm      DOUBLE PRECISION,
    sigma_angle_deg        DOUBLE PRECISION,
    position_x             DOUBLE PRECISION,
    position_y             DOUBLE PRECISION,
    position_z             DOUBLE PRECISION,
    n_detections           BIGINT,
    n_rejected_detections  BIGINT,
    PRIMARY KEY (job_id, camera_index)
);

CREATE TABLE person_results (
    job_id                 TEXT NOT NULL REFERENCES jobs (id) ON DELETE CASCADE,
    person                 BIGINT NOT NULL,
    first_frame            BIGINT,
    last_frame             BIGINT,
    n_frames               BIGINT NOT NULL,
    n_valid_frames         BIGINT NOT NULL,
    n_detections           BIGINT,
    reprojection_mean_px   DOUBLE PRECISION,
    reprojection_median_px DOUBLE PRECISION,
    bone_length_spread     DOUBLE PRECISION,
    jitter_m_per_s2        DOUBLE PRECISION,
    PRIMARY KEY (job_id, person)
);

CREATE TABLE webhook_deliveries (
    seq         BIGINT GENERATED ALWAYS AS IDENTITY PRIMARY KEY,
    id          TEXT NOT NULL UNIQUE,
    tenant      TEXT NOT NULL,
    job_id      TEXT NOT NULL REFERENCES jobs (id) ON DELETE CASCADE,
    event       TEXT NOT NULL,
    url         TEXT NOT NULL,
    state       TEXT NOT NULL CHECK (state IN ('waiting', 'delivered', 'failed')),
    tries       BIGINT NOT NULL DEFAULT 0,
    next_try_at BIGINT NOT NULL DEFAULT 0,
    last_status BIGINT,
    last_error  TEXT,
    created_at  TEXT NOT NULL,
    updated_at  TEXT NOT NULL
);
CREATE INDEX webhook_deliveries_waiting ON webhook_deliveries (next_try_at) WHERE state = 'waiting';
CREATE INDEX webhook_deliveries_by_job ON webhook_deliveries (job_id, seq);

CREATE TABLE clock (
    id        BIGINT PRIMARY KEY CHECK (id = 1),
    seen_at   BIGINT NOT NULL,
    suspect_s BIGINT NOT NULL DEFAULT 0
);
INSERT INTO clock (id, seen_at) VALUES (1, unixepoch());

-- The only row is the store of the uploads and results.
CREATE TABLE storage (
    id        BIGINT PRIMARY KEY CHECK (id = 1),
    blobs_url TEXT NOT NULL
);

-- The triggers of SQLite, one function for each moment.
CREATE FUNCTION before_state_of_job() RETURNS TRIGGER LANGUAGE plpgsql AS $$
BEGIN
    IF OLD.state IN ('succeeded', 'failed', 'canceled', 'dead') THEN
        RAISE EXCEPTION 'a final state never changes' USING ERRCODE = 'check_violation';
    END IF;
    RETURN NEW;
END $$;
CREATE TRIGGER jobs_final_states_stay BEFORE UPDATE OF state ON jobs FOR EACH ROW
    WHEN (NEW.state <> OLD.state) EXECUTE FUNCTION before_state_of_job();

CREATE FUNCTION add_to_tenant(tenant_name TEXT, job_state TEXT, n BIGINT, bytes BIGINT) RETURNS VOID LANGUAGE sql AS $$
    UPDATE tenants SET n_queued = n_queued + CASE job_state WHEN 'queued' THEN n ELSE 0 END,
                       n_running = n_running + CASE job_state WHEN 'running' THEN n ELSE 0 END,
                       n_canceling = n_canceling + CASE job_state WHEN 'canceling' THEN n ELSE 0 END,
                       n_succeeded = n_succeeded + CASE job_state WHEN 'succeeded' THEN n ELSE 0 END,
                       n_failed = n_failed + CASE job_state WHEN 'failed' THEN n ELSE 0 END,
                       n_canceled = n_canceled + CASE job_state WHEN 'canceled' THEN n ELSE 0 END,
                       n_dead = n_dead + CASE job_state WHEN 'dead' THEN n ELSE 0 END,
                       stored_bytes = stored_bytes + bytes
        WHERE name = tenant_name
$$;

CREATE FUNCTION after_insert_of_job() RETURNS TRIGGER LANGUAGE plpgsql AS $$
BEGIN
    INSERT INTO tenants (name) VALUES (NEW.tenant) ON CONFLICT (name) DO NOTHING;
    PERFORM add_to_tenant(NEW.tenant, NEW.state, 1, NEW.result_bytes);
    IF NEW.labels <> '{}' THEN
        INSERT INTO job_labels (tenant, key, seq, value)
            SELECT NEW.tenant, label.key, NEW.seq, label.value FROM json_each(NEW.labels) AS label;
    END IF;
    RETURN NULL;
END $$;
CREATE TRIGGER jobs_inserted AFTER INSERT ON jobs FOR EACH ROW EXECUTE FUNCTION after_insert_of_job();

-- Whatever ends a job (its child, a cancel, the leader), its receiver is called.
CREATE FUNCTION after_state_of_job() RETURNS TRIGGER LANGUAGE plpgsql AS $$
BEGIN
    UPDATE tenants SET
        n_queued = n_queued + (NEW.state = 'queued')::int - (OLD.state = 'queued')::int,
        n_running = n_running + (NEW.state = 'running')::int - (OLD.state = 'running')::int,
        n_canceling = n_canceling + (NEW.state = 'canceling')::int - (OLD.state = 'canceling')::int,
        n_succeeded = n_succeeded + (NEW.state = 'succeeded')::int,
        n_failed = n_failed + (NEW.state = 'failed')::int,
        n_canceled = n_canceled + (NEW.state = 'canceled')::int,
        n_dead = n_dead + (NEW.state = 'dead')::int
        WHERE name = NEW.tenant;
    IF NEW.webhook IS NOT NULL AND NEW.state IN ('succeeded', 'failed', 'canceled', 'dead') THEN
        INSERT INTO webhook_deliveries (id, tenant, job_id, event, url, state, created_at, updated_at)
        VALUES ('delivery_' || replace(gen_random_uuid()::text, '-', ''), NEW.tenant, NEW.id, 'job.' || NEW.state, NEW.webhook,
                'waiting', strftime('', 'now'), strftime('', 'now'));
    END IF;
    RETURN NULL;
END $$;
CREATE TRIGGER jobs_recounted AFTER UPDATE OF state ON jobs FOR EACH ROW
    WHEN (NEW.state <> OLD.state) EXECUTE FUNCTION after_state_of_job();

CREATE FUNCTION after_bytes_of_job() RETURNS TRIGGER LANGUAGE plpgsql AS $$
BEGIN
    UPDATE tenants SET stored_bytes = stored_bytes + NEW.result_bytes - OLD.result_bytes WHERE name = NEW.tenant;
    RETURN NULL;
END $$;
CREATE TRIGGER results_stored AFTER UPDATE OF result_bytes ON jobs FOR EACH ROW
    WHEN (NEW.result_bytes <> OLD.result_bytes) EXECUTE FUNCTION after_bytes_of_job();

CREATE FUNCTION after_delete_of_job() RETURNS TRIGGER LANGUAGE plpgsql AS $$
BEGIN
    PERFORM add_to_tenant(OLD.tenant, OLD.state, -1, -OLD.result_bytes);
    IF OLD.labels <> '{}' THEN
        DELETE FROM job_labels
            WHERE tenant = OLD.tenant AND seq = OLD.seq AND key IN (SELECT label.key FROM json_each(OLD.labels) AS label);
    END IF;
    RETURN NULL;
END $$;
CREATE TRIGGER jobs_deleted AFTER DELETE ON jobs FOR EACH ROW EXECUTE FUNCTION after_delete_of_job();

CREATE FUNCTION after_insert_of_session() RETURNS TRIGGER LANGUAGE plpgsql AS $$
BEGIN
    INSERT INTO tenants (name) VALUES (NEW.tenant) ON CONFLICT (name) DO NOTHING;
    PERFORM add_to_tenant(NEW.tenant, '', 0, NEW.bytes);
    RETURN NULL;
END $$;
CREATE TRIGGER sessions_stored AFTER INSERT ON sessions FOR EACH ROW EXECUTE FUNCTION after_insert_of_session();

CREATE FUNCTION after_delete_of_session() RETURNS TRIGGER LANGUAGE plpgsql AS $$
BEGIN
    PERFORM add_to_tenant(OLD.tenant, '', 0, -OLD.bytes);
    RETURN NULL;
END $$;
CREATE TRIGGER sessions_released AFTER DELETE ON sessions FOR EACH ROW EXECUTE FUNCTION after_delete_of_session();
