"""MLflow's view of what is on disk; the only room that knows MLflow. Another tracker is another folder in its place.

Runs are published whole: one that was deleted or edited in MLflow is made again from its folder.
"""

import os

import lazy_loader

for _name, _value in {
    "MLFLOW_DISABLE_TELEMETRY": "true",
    "MLFLOW_HTTP_REQUEST_TIMEOUT": "20",  # s; a server that does not answer is asked again later
    "MLFLOW_HTTP_REQUEST_MAX_RETRIES": "0",
    "MLFLOW_SQLALCHEMYSTORE_POOLCLASS": "NullPool",  # no open file: a database that is replaced is noticed
}.items():
    os.environ.setdefault(_name, _value)

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
