-- Why: probable mistakes in the files of a recording were in `report.json` alone; a client that follows its job did not see them.
-- Only an addition, so that nodes of the release before go on working: their results get an empty list.
ALTER TABLE verdicts ADD COLUMN suspicions TEXT NOT NULL DEFAULT '[]'; -- JSON list, as in `report.json`
