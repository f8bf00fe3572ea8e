-- Why: `crashes` is the plain name of the number of crashes of a job's child process; crashes of the service do not count.
-- The earlier migrations keep their text: sqlx compares the checksum of each applied migration with its file.
ALTER TABLE jobs RENAME COLUMN deaths TO crashes;
