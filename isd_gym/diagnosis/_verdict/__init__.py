"""The verdict: evidence, gates, findings and their wording."""
