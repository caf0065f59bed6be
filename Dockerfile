# The build for CPUs, in a container (docs/usage.md):
#
#   docker build -t ia_bench --build-arg PIP_EXTRA_INDEX_URL=URL_OF_CPU_BUILDS .
#   docker run --rm -v "$PWD/results:/ia_bench/results" ia_bench run scene=tiny preset=smoke
FROM python:3.11-slim-bookworm
RUN apt-get update && apt-get install -y --no-install-recommends git make && rm -rf /var/lib/apt/lists/*
ARG PIP_EXTRA_INDEX_URL
WORKDIR /ia_bench
COPY . .
RUN make setup && rm -rf /root/.cache
ENV PATH=/ia_bench/.venv/bin:$PATH
ENTRYPOINT ["ia-bench"]
