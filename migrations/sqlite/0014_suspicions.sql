-- Why: probable mistakes in the files of a recording were in `report.json` alone; a client that follows its job did not see them.
ALTER TABLE verdicts ADD COLUMN suspicions TEXT NOT NULL DEFAULT '[]'; -- JSON list, as in `report.json`; empty for results of before
