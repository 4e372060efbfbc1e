# Images of upvl, for machines without a GPU and with NVIDIA GPUs:
#
#     docker build --target cpu  --tag upvl:cpu  .
#     docker build --target cuda --tag upvl:cuda .
#     docker run --rm --read-only --tmpfs /tmp --volume "$PWD":/work upvl:cpu autolabel --all-motion
#
# The process has no rights (user 10001) and needs to write in two places alone: /work, or wherever --out is, and /tmp.
# docs/scale.md has the commands for Kubernetes and Ray.

# The Python that the tests run on; constraints.txt pins the packages.
ARG PYTHON=3.11

FROM python:${PYTHON}-slim AS wheel
WORKDIR /source
COPY pyproject.toml README.md LICENSE workspace.mk ./
COPY LICENSES LICENSES
COPY stages stages
COPY src src
RUN python -m pip wheel --no-cache-dir --no-deps --wheel-dir /wheels .

# What both images share: no sources, no compiler, no rights.
FROM python:${PYTHON}-slim AS base
RUN groupadd --gid 10001 upvl \
    && useradd --uid 10001 --gid 10001 --no-create-home --home-dir /tmp --shell /usr/sbin/nologin upvl \
    && mkdir /work \
    && chown 10001:10001 /work
# Caches go where a tmp volume is, so that the root file system can be read-only.
ENV PYTHONDONTWRITEBYTECODE=1 \
    PYTHONUNBUFFERED=1 \
    XDG_CACHE_HOME=/tmp/cache \
    XDG_CONFIG_HOME=/tmp/config \
    MPLCONFIGDIR=/tmp/matplotlib \
    UPVL_CACHE=/tmp/upvl
WORKDIR /work

FROM base AS cpu
ARG EXTRAS=index,onnx,ray,storage,synthetic
# The index of PyTorch has wheels without CUDA, which are ten times smaller.
ARG TORCH_INDEX=https://download.pytorch.org/whl/cpu
RUN --mount=type=bind,from=wheel,source=/wheels,target=/wheels \
    --mount=type=bind,source=constraints.txt,target=/constraints.txt \
    python -m pip install --no-cache-dir --no-deps --constraint /constraints.txt --index-url "${TORCH_INDEX}" torch \
    && python -m pip install --no-cache-dir --constraint /constraints.txt "$(echo /wheels/upvl-*.whl)[${EXTRAS}]"
USER 10001:10001
VOLUME ["/work"]
ENTRYPOINT ["upvl"]
CMD ["--help"]

FROM base AS cuda
ARG EXTRAS=index,onnx,ray,storage,synthetic
# The wheels of PyPI bring the libraries of CUDA; the host gives the driver (NVIDIA Container Toolkit).
ARG TORCH_INDEX=https://pypi.org/simple
ENV NVIDIA_VISIBLE_DEVICES=all \
    NVIDIA_DRIVER_CAPABILITIES=compute,utility
RUN --mount=type=bind,from=wheel,source=/wheels,target=/wheels \
    --mount=type=bind,source=constraints.txt,target=/constraints.txt \
    python -m pip install --no-cache-dir --no-deps --constraint /constraints.txt --index-url "${TORCH_INDEX}" torch \
    && python -m pip install --no-cache-dir --constraint /constraints.txt "$(echo /wheels/upvl-*.whl)[${EXTRAS}]"
USER 10001:10001
VOLUME ["/work"]
ENTRYPOINT ["upvl"]
CMD ["--help"]
