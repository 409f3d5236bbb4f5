# The default study in a container; its results appear in ./runs.
#   docker build -t ablate .
#   docker run --rm -v "$PWD/runs:/data/runs" ablate
# Another command: docker run --rm ablate task=describe
FROM debian:bookworm-slim

RUN apt-get update \
 && apt-get install -y --no-install-recommends python3 python3-venv \
 && rm -rf /var/lib/apt/lists/* \
 && python3 -m venv /opt/ablate
ENV PATH=/opt/ablate/bin:$PATH MLFLOW_DISABLE_TELEMETRY=true PYTHONUNBUFFERED=1

# The packages of PyTorch for processors alone; for a GPU: --build-arg PIP_OPTIONS=
ARG PIP_OPTIONS="--extra-index-url https://download.pytorch.org/whl/cpu"
WORKDIR /opt/source
COPY pyproject.toml constraints.txt README.md LICENSE ./
COPY src src
COPY conf conf
RUN pip install --no-cache-dir $PIP_OPTIONS -c constraints.txt '.[parallel]'

WORKDIR /data
ENTRYPOINT ["python", "-m", "ablate"]
CMD ["-m", "variant=sa2h,sa2h-att,nsa2h"]
