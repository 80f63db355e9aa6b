# The bedside monitor and batches of recordings: docker build -t kinegraph . && docker run --rm kinegraph --help
# A session that runs for the night: docker run --rm -v $PWD/recordings:/work/recordings kinegraph run bedside_simulated --view lines
FROM python:3.11-slim AS build
WORKDIR /src
COPY . .
RUN pip install --no-cache-dir build && python -m build --outdir /dist

FROM python:3.11-slim
RUN useradd --create-home --uid 1000 kinegraph
COPY --from=build /dist/*.whl /tmp/
RUN pip install --no-cache-dir "$(ls /tmp/*.whl)[batch]" && rm /tmp/*.whl
USER kinegraph
WORKDIR /work
ENTRYPOINT ["kinegraph"]
