-- Why: uploads and results can lie outside the data folder. A service that is started with another store than before would find none
-- of them, so the store is remembered, and another one is refused.

-- The only row is the store of the uploads and results; `file:` is the data folder.
CREATE TABLE storage (
    id        INTEGER PRIMARY KEY CHECK (id = 1),
    blobs_url TEXT NOT NULL
) STRICT;
INSERT INTO storage (id, blobs_url) VALUES (1, 'file:');
