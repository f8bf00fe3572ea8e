-- Why: with thousands of tenants and a million waiting jobs, whose turn it is, whether the queue is full and how many jobs
-- there are must be known without a count. Triggers keep one row of counters for each tenant, beside its stored bytes; they
-- take the place of `job_counts`.
ALTER TABLE tenants ADD COLUMN n_queued INTEGER NOT NULL DEFAULT 0;
ALTER TABLE tenants ADD COLUMN n_running INTEGER NOT NULL DEFAULT 0;
ALTER TABLE tenants ADD COLUMN n_canceling INTEGER NOT NULL DEFAULT 0;
ALTER TABLE tenants ADD COLUMN n_succeeded INTEGER NOT NULL DEFAULT 0;
ALTER TABLE tenants ADD COLUMN n_failed INTEGER NOT NULL DEFAULT 0;
ALTER TABLE tenants ADD COLUMN n_canceled INTEGER NOT NULL DEFAULT 0;
ALTER TABLE tenants ADD COLUMN n_dead INTEGER NOT NULL DEFAULT 0;

DROP TRIGGER jobs_counted;
DROP TRIGGER jobs_recounted;
DROP TRIGGER jobs_uncounted;
INSERT INTO tenants (name) SELECT tenant FROM job_counts WHERE true ON CONFLICT (name) DO NOTHING;
UPDATE tenants SET
    n_queued = coalesce((SELECT jobs FROM job_counts WHERE tenant = name AND state = 'queued'), 0),
    n_running = coalesce((SELECT jobs FROM job_counts WHERE tenant = name AND state = 'running'), 0),
    n_canceling = coalesce((SELECT jobs FROM job_counts WHERE tenant = name AND state = 'canceling'), 0),
    n_succeeded = coalesce((SELECT jobs FROM job_counts WHERE tenant = name AND state = 'succeeded'), 0),
    n_failed = coalesce((SELECT jobs FROM job_counts WHERE tenant = name AND state = 'failed'), 0),
    n_canceled = coalesce((SELECT jobs FROM job_counts WHERE tenant = name AND state = 'canceled'), 0),
    n_dead = coalesce((SELECT jobs FROM job_counts WHERE tenant = name AND state = 'dead'), 0);
DROP TABLE job_counts;

-- The claim takes the first row: the tenant that was served the longest ago of those with waiting jobs. The sum of
-- `n_queued` is read from this index alone.
CREATE INDEX tenants_waiting ON tenants (turn, name, n_queued) WHERE n_queued > 0;
-- The last turn, of all tenants.
CREATE INDEX tenants_by_turn ON tenants (turn);

CREATE TRIGGER jobs_counted AFTER INSERT ON jobs
BEGIN
    INSERT INTO tenants (name) VALUES (NEW.tenant) ON CONFLICT (name) DO NOTHING;
    UPDATE tenants SET n_queued = n_queued + (NEW.state = 'queued'),
                       n_running = n_running + (NEW.state = 'running'),
                       n_canceling = n_canceling + (NEW.state = 'canceling'),
                       n_succeeded = n_succeeded + (NEW.state = 'succeeded'),
                       n_failed = n_failed + (NEW.state = 'failed'),
                       n_canceled = n_canceled + (NEW.state = 'canceled'),
                       n_dead = n_dead + (NEW.state = 'dead')
        WHERE name = NEW.tenant;
END;
CREATE TRIGGER jobs_recounted AFTER UPDATE OF state ON jobs WHEN NEW.state <> OLD.state
BEGIN
    UPDATE tenants SET n_queued = n_queued + (NEW.state = 'queued') - (OLD.state = 'queued'),
                       n_running = n_running + (NEW.state = 'running') - (OLD.state = 'running'),
                       n_canceling = n_canceling + (NEW.state = 'canceling') - (OLD.state = 'canceling'),
                       n_succeeded = n_succeeded + (NEW.state = 'succeeded') - (OLD.state = 'succeeded'),
                       n_failed = n_failed + (NEW.state = 'failed') - (OLD.state = 'failed'),
                       n_canceled = n_canceled + (NEW.state = 'canceled') - (OLD.state = 'canceled'),
                       n_dead = n_dead + (NEW.state = 'dead') - (OLD.state = 'dead')
        WHERE name = NEW.tenant;
END;
CREATE TRIGGER jobs_uncounted AFTER DELETE ON jobs
BEGIN
    UPDATE tenants SET n_queued = n_queued - (OLD.state = 'queued'),
                       n_running = n_running - (OLD.state = 'running'),
                       n_canceling = n_canceling - (OLD.state = 'canceling'),
                       n_succeeded = n_succeeded - (OLD.state = 'succeeded'),
                       n_failed = n_failed - (OLD.state = 'failed'),
                       n_canceled = n_canceled - (OLD.state = 'canceled'),
                       n_dead = n_dead - (OLD.state = 'dead')
        WHERE name = OLD.tenant;
END;
