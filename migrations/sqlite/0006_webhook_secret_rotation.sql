-- Why: a secret that became known must be replaceable without a moment in which receivers refuse calls. The replaced secret
-- signs beside the new one for a day.
ALTER TABLE tenants ADD COLUMN previous_webhook_secret TEXT;  -- the secret before the last rotation
ALTER TABLE tenants ADD COLUMN webhook_secret_set_at INTEGER; -- Unix seconds of the last rotation
