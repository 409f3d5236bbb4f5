"""PostgreSQL and MLflow's server with passwords, as docs/cluster.md has them, on loopback for a test."""

import os
import pwd
import secrets
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import urllib.request
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import psycopg2

from support.viewed_body import free_port

_SCHEME = "postgresql+psycopg2"  # SQLAlchemy 2.1 takes another driver where none is named
_UP_S = 300.0  # beside other work MLflow's server takes a minute
_BINARIES = sorted(Path("/usr/lib/postgresql").glob("*/bin"), reverse=True)  # Debian has them outside of PATH


class Process:
    """A server that can be started, killed and started again; what it prints goes into a file."""

    def __init__(self, command: list[str], environment: dict[str, str], log: Path, account: str | None = None) -> None:
        self._command, self._environment, self._log, self._account = command, environment, log, account
        self._process: subprocess.Popen[bytes] | None = None

    def start(self, is_up: Callable[[], bool]) -> None:
        """Start it and wait until it answers."""
        with self._log.open("ab") as log:
            self._process = subprocess.Popen(
                self._command,
                env={**os.environ, **self._environment},
                start_new_session=True,
                stdout=log,
                stderr=log,
                user=self._account,
            )
        until = time.monotonic() + _UP_S
        while not is_up():
            if self._process.poll() is not None or time.monotonic() > until:
                raise RuntimeError(f"{self._command[0]} does not answer: {self._log.read_text('utf-8')[-1000:]}")
            time.sleep(0.1)

    def kill(self) -> None:
        """SIGKILL to all of its processes."""
        if self._process is not None:
            with suppress(ProcessLookupError):
                os.killpg(self._process.pid, signal.SIGKILL)
            self._process.wait()


class Postgres(Process):
    """A cluster of its own, which asks its one user, `mlflow`, for a password."""

    def __init__(self, binaries: Path, folder: Path, account: str | None) -> None:
        self.port, self.password, self._binaries = free_port(), secrets.token_hex(8), binaries
        word = folder / "password"
        word.write_text(self.password)
        if account is not None:
            for path in (folder, word):
                shutil.chown(path, account)
        made = [binaries / "initdb", "--username=mlflow", f"--pwfile={word}", "--auth=scram-sha-256", folder / "data"]
        subprocess.run(made, check=True, capture_output=True, user=account)
        word.unlink()
        command = [str(binaries / "postgres"), "-D", str(folder / "data"), "-p", str(self.port), "-k", str(folder)]
        log = folder / "postgres.txt"
        super().__init__([*command, "-c", "listen_addresses=127.0.0.1"], {}, log, account)

    def up(self) -> None:
        """Start it, and wait until it takes connections."""
        asks = [self._binaries / "pg_isready", "--quiet", "--host=127.0.0.1", f"--port={self.port}"]
        self.start(lambda: subprocess.run(asks, check=False).returncode == 0)

    def place(self, database: str) -> str:
        """Where a database is, after the scheme of its URI; the password is in PGPASSWORD."""
        return f"://mlflow@127.0.0.1:{self.port}/{database}"

    def connection(self, database: str) -> psycopg2.extensions.connection:
        """A connection of its own, without MLflow."""
        return psycopg2.connect(f"postgresql{self.place(database)}", password=self.password)


class Mlflow(Process):
    """MLflow's server over PostgreSQL; its administrator is `admin`."""

    def __init__(self, postgres: Postgres, folder: Path) -> None:
        self.password, port = secrets.token_hex(8), free_port()
        self.uri = f"http://127.0.0.1:{port}"
        users = folder / "users.ini"
        made = f"[mlflow]\ndefault_permission = READ\ndatabase_uri = {_SCHEME}{postgres.place('mlflow_users')}\n"
        users.write_text(f"{made}auth_cache_ttl_seconds = 60\n")
        environment = {
            "PGPASSWORD": postgres.password,
            "MLFLOW_AUTH_CONFIG_PATH": str(users),
            "MLFLOW_AUTH_ADMIN_USERNAME": "admin",
            "MLFLOW_AUTH_ADMIN_PASSWORD": self.password,
            "MLFLOW_FLASK_SERVER_SECRET_KEY": secrets.token_hex(16),
            "MLFLOW_SERVER_ENABLE_JOB_EXECUTION": "false",
        }
        command = [sys.executable, "-m", "mlflow", "server", "--app-name", "basic-auth", "--host", "127.0.0.1"]
        stores = ["--backend-store-uri", f"{_SCHEME}{postgres.place('mlflow')}"]
        artifacts = ["--artifacts-destination", str(folder / "artifacts")]
        command += ["--port", str(port), "--workers", "2", *stores, *artifacts]
        super().__init__(command, environment, folder / "mlflow.txt")

    def up(self) -> None:
        self.start(lambda: answers(f"{self.uri}/health"))


def answers(url: str) -> bool:
    """Whether a page is there."""
    with suppress(OSError), urllib.request.urlopen(url, timeout=5) as page:
        return bool(page.status == 200)
    return False


def why_no_postgres() -> str:
    """Why there can be no cluster here; nothing where there can."""
    if not _BINARIES:
        return "PostgreSQL is not installed (Debian: apt-get install postgresql)"
    if os.geteuid() == 0 and _account() is None:
        return "PostgreSQL does not run as root, and there is no account `postgres`"
    return ""


@contextmanager
def new_postgres() -> Iterator[Postgres]:
    """A cluster that has started, with the databases that MLflow needs; it is removed at the end."""
    # A test's folder is closed to the account that PostgreSQL needs where this is root.
    with tempfile.TemporaryDirectory(prefix="ablate-postgres-") as folder:
        server = Postgres(_BINARIES[0], Path(folder), _account())
        try:
            server.up()
            connection = server.connection("postgres")
            connection.autocommit = True
            with connection.cursor() as cursor:
                for database in ("mlflow", "mlflow_users"):
                    cursor.execute(f"CREATE DATABASE {database}")
            connection.close()
            yield server
        finally:
            server.kill()


def _account() -> str | None:
    """Who runs PostgreSQL where this is root, which it refuses."""
    if os.geteuid() != 0:
        return None
    with suppress(KeyError):
        return pwd.getpwnam("postgres").pw_name
    return None
