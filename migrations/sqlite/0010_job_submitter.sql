-- Why: an operator who reads why a job failed needs the key and the request that submitted it, also days later and after
-- restarts of the service.
ALTER TABLE jobs ADD COLUMN request_id TEXT; -- `X-Request-Id` of the submission
ALTER TABLE jobs ADD COLUMN key_id TEXT;     -- public part of the API key; NULL where no key is required
