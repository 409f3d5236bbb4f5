"""MLflow's SQLite file without a run: a copy saves the seconds that MLflow takes to lay one out."""

from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory


@cache
def empty_database() -> bytes:
    """What the file holds."""
    from mlflow import MlflowClient  # takes a second, which many tests can do without

    with TemporaryDirectory() as folder:
        path = Path(folder) / "mlflow.db"
        MlflowClient(f"sqlite:///{path}").search_experiments()
        return path.read_bytes()
