-- Why: the rows of a job are the same in both databases. With PostgreSQL workers of several sizes and releases share the queue
-- (`migrations/postgres/0002_classes_losses_and_gate.sql`); the only process of a data folder runs every job.
ALTER TABLE jobs ADD COLUMN class INTEGER NOT NULL DEFAULT 0; -- how much memory the job needs
ALTER TABLE jobs ADD COLUMN needs INTEGER NOT NULL DEFAULT 0; -- the level of options that a worker must know
-- The figures read the oldest waiting job of all tenants. Without `state` in it the index is not chosen.
CREATE INDEX jobs_waiting_oldest ON jobs (state, seq) WHERE state = 'queued';
