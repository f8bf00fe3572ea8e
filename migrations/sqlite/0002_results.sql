-- Why: a download needs the digest of what was published, and figures of many jobs are compared in SQL. All rows of a job
-- are written in the transaction that makes it `succeeded`, out of the published files, and vanish with the job.

-- One row is one published file of a job.
CREATE TABLE artifacts (
    job_id     TEXT NOT NULL REFERENCES jobs (id) ON DELETE CASCADE,
    name       TEXT NOT NULL,                    -- path below the result folder, with `/`
    media_type TEXT NOT NULL,
    bytes      INTEGER NOT NULL,
    sha256     TEXT NOT NULL,
    PRIMARY KEY (job_id, name)
) STRICT, WITHOUT ROWID;

-- One row is the verdict over one job's result, with the figures of the whole result (`report.json`).
CREATE TABLE verdicts (
    job_id              TEXT PRIMARY KEY REFERENCES jobs (id) ON DELETE CASCADE,
    verdict             TEXT NOT NULL CHECK (verdict IN ('pass', 'warn', 'reject')),
    reasons             TEXT NOT NULL,           -- JSON list of sentences
    heldout_px          REAL,
    scale               REAL,
    scale_low95         REAL,
    scale_high95        REAL,
    rejected_detections REAL NOT NULL            -- share, 0 to 1
) STRICT, WITHOUT ROWID;

-- One row is one stage of one job (`report.json`, `stages`).
CREATE TABLE stage_metrics (
    job_id      TEXT NOT NULL REFERENCES jobs (id) ON DELETE CASCADE,
    stage_index INTEGER NOT NULL,                -- order of running
    stage       TEXT NOT NULL,
    iterations  INTEGER NOT NULL,
    cost_before REAL,
    cost_after  REAL,
    termination TEXT NOT NULL,
    PRIMARY KEY (job_id, stage_index)
) STRICT, WITHOUT ROWID;

-- One row is one further figure of a stage; its unit is in its name.
CREATE TABLE stage_metric_values (
    job_id      TEXT NOT NULL REFERENCES jobs (id) ON DELETE CASCADE,
    stage_index INTEGER NOT NULL,
    name        TEXT NOT NULL,
    value       REAL,                            -- null where the figure was not finite
    PRIMARY KEY (job_id, stage_index, name)
) STRICT, WITHOUT ROWID;

-- One row is one camera of one job (`cameras.json`, and `report.json` for the detections).
CREATE TABLE camera_results (
    job_id                 TEXT NOT NULL REFERENCES jobs (id) ON DELETE CASCADE,
    camera_index           INTEGER NOT NULL,     -- the session's order
    camera                 TEXT NOT NULL,
    status                 TEXT NOT NULL CHECK (status IN ('solved', 'unsolved')),
    n_observations         INTEGER NOT NULL,
    reprojection_mean_px   REAL,
    reprojection_median_px REAL,
    sigma_position_mm      REAL,
    sigma_angle_deg        REAL,
    position_x             REAL,                 -- centre in the result's world, m
    position_y             REAL,
    position_z             REAL,
    n_detections           INTEGER,
    n_rejected_detections  INTEGER,
    PRIMARY KEY (job_id, camera_index)
) STRICT, WITHOUT ROWID;

-- One row is one person of one job (`people.json` for the frames, `report.json` for the figures).
CREATE TABLE person_results (
    job_id                 TEXT NOT NULL REFERENCES jobs (id) ON DELETE CASCADE,
    person                 INTEGER NOT NULL,
    first_frame            INTEGER,
    last_frame             INTEGER,
    n_frames               INTEGER NOT NULL,
    n_valid_frames         INTEGER NOT NULL,
    n_detections           INTEGER,
    reprojection_mean_px   REAL,
    reprojection_median_px REAL,
    bone_length_spread     REAL,
    jitter_m_per_s2        REAL,
    PRIMARY KEY (job_id, person)
) STRICT, WITHOUT ROWID;
