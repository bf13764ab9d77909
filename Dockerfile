# syntax=docker/dockerfile:1
# One image with all three commands, made from wheels: docker build -t joulebox .
ARG PYTHON_IMAGE=python:3.11-slim

FROM ${PYTHON_IMAGE} AS wheels
WORKDIR /source
COPY constraints.txt .
RUN pip install --no-cache-dir -c constraints.txt hatchling
COPY renderer renderer
COPY agent agent
COPY server server
COPY web web
COPY scenes scenes
RUN pip wheel --no-cache-dir --no-deps --no-build-isolation --wheel-dir /wheels ./renderer ./agent ./server

FROM ${PYTHON_IMAGE}
RUN --mount=type=bind,from=wheels,source=/wheels,target=/wheels \
    --mount=type=bind,source=constraints.txt,target=/constraints.txt \
    pip install --no-cache-dir -c /constraints.txt /wheels/*.whl
RUN useradd --create-home --uid 1000 joulebox && install -d -o joulebox -g joulebox /var/lib/joulebox
USER joulebox
# Compiled here, so that no container spends its first minute on it.
RUN joulebox-render warm-up
WORKDIR /var/lib/joulebox
VOLUME /var/lib/joulebox
ENV JOULEBOX_DATA=/var/lib/joulebox/server
EXPOSE 8473
# Of a server; whoever runs an agent in this image gives it another (see docker-compose.yml).
HEALTHCHECK --interval=10s --timeout=5s --start-period=30s --retries=3 \
    CMD ["python", "-c", "import urllib.request as r; r.urlopen('http://127.0.0.1:8473/readyz', timeout=4)"]
# Refused unless tokens protect it: run it with --enrollment-secret-file, or make a token in its volume first.
CMD ["joulebox", "serve", "--host", "0.0.0.0", "--port", "8473"]
