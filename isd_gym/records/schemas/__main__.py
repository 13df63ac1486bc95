"""Write the schema of models, after an element was added or changed."""

from pathlib import Path

from . import dumps, model_schema

(Path(__file__).parent / "isd-model-1.json").write_text(dumps(model_schema()), encoding="utf-8")
