# evalkit with all back ends and the system libraries of Open3D, from the locked and hashed packages.
#   docker build -t evalkit .
#   docker run --rm --user "$(id -u):$(id -g)" --volume "$PWD:/work" evalkit compare drive.bag
# The base images are pinned by version, not by digest: security updates of Debian arrive with a new build.
FROM python:3.11-slim-bookworm AS build
SHELL ["/bin/bash", "-o", "pipefail", "-c"]
WORKDIR /source
COPY .ci/system-packages .ci/lock.txt .ci/
RUN .ci/system-packages python && rm -rf /var/lib/apt/lists/*
RUN python -m venv /opt/evalkit \
    && /opt/evalkit/bin/pip install --no-cache-dir --require-hashes --requirement .ci/lock.txt
COPY . .
RUN /opt/evalkit/bin/pip install --no-cache-dir --no-deps .

# For .devcontainer: compilers, a browser for the tests, and the sources from the editor's mount.
FROM build AS develop
# Debian keeps one version of a package.
# hadolint ignore=DL3008
RUN .ci/system-packages open3d browser \
    && apt-get update -qq && apt-get install -y -qq --no-install-recommends git make && rm -rf /var/lib/apt/lists/*
ENV PATH=/opt/evalkit/bin:$PATH

FROM python:3.11-slim-bookworm AS run
COPY .ci/system-packages /tmp/system-packages
RUN /tmp/system-packages open3d && rm -rf /var/lib/apt/lists/* /tmp/system-packages
COPY --from=build /opt/evalkit /opt/evalkit
# Results go to /work, downloaded recordings to the cache; both may belong to any user.
ENV PATH=/opt/evalkit/bin:$PATH XDG_CACHE_HOME=/cache MPLCONFIGDIR=/tmp/matplotlib
RUN mkdir -p /work /cache && chmod 1777 /work /cache
WORKDIR /work
VOLUME /cache
USER 1000:1000
ENTRYPOINT ["evalkit"]
CMD ["--help"]
