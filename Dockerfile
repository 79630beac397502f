# skypose on the CPU: PoCL for OpenCL, Mesa for OpenGL without a display. Listens on 8000, keeps everything under /data.
ARG BASE=debian:bookworm-slim

FROM ${BASE} AS build
RUN apt-get update \
 && DEBIAN_FRONTEND=noninteractive apt-get install -y --no-install-recommends python3 python3-venv ca-certificates \
 && apt-get clean && rm -rf /var/lib/apt/lists/*
RUN python3 -m venv /opt/skypose
WORKDIR /src
# The packages first: they change less often than the code, and the layer is kept.
COPY requirements.lock ./
RUN /opt/skypose/bin/pip install --no-cache-dir --require-hashes --no-deps -r requirements.lock
COPY pyproject.toml README.md LICENSE ./
COPY gpu gpu
COPY service service
RUN /opt/skypose/bin/pip install --no-cache-dir --no-deps --no-build-isolation --no-index . \
 && /opt/skypose/bin/pip uninstall --yes setuptools pip \
 && find /opt/skypose -type d -name tests -prune -exec rm -r {} +

FROM ${BASE}
# PoCL brings a whole compiler. Its manuals, headers, static libraries, sanitizers and 32-bit parts are never used here.
RUN printf 'path-exclude=%s\n' '/usr/share/doc/*' '/usr/share/man/*' '/usr/share/locale/*' '/usr/lib/llvm-*/lib/*.a' \
      '/usr/lib/llvm-*/lib/clang/*/lib/*' '/usr/lib/*/lib?san.so*' \
      '/usr/lib/*/libclang-1?.so*' '/usr/lib32/*' '/usr/include/*' >/etc/dpkg/dpkg.cfg.d/lean \
 && echo 'path-include=/usr/share/doc/*/copyright' >>/etc/dpkg/dpkg.cfg.d/lean \
 && apt-get update \
 && DEBIAN_FRONTEND=noninteractive apt-get install -y --no-install-recommends \
      python3 pocl-opencl-icd ocl-icd-libopencl1 libegl1 libgl1 libgl1-mesa-dri libgles2 \
 && apt-get clean && rm -rf /var/lib/apt/lists/*
RUN useradd --system --uid 10001 --user-group --no-create-home --home-dir /nonexistent skypose \
 && install -d -o skypose -g skypose /data /var/cache/skypose
COPY --from=build /opt/skypose /opt/skypose
# Compiled kernels are kept out of /data: they are worth nothing on another machine.
ENV PATH=/opt/skypose/bin:$PATH \
    PYTHONDONTWRITEBYTECODE=1 \
    PYTHONUNBUFFERED=1 \
    XDG_CACHE_HOME=/var/cache/skypose \
    POCL_CACHE_DIR=/var/cache/skypose/pocl
USER skypose
WORKDIR /data
VOLUME /data
EXPOSE 8000
HEALTHCHECK --interval=10s --timeout=5s --start-period=60s --retries=3 \
  CMD ["python3", "-c", "import urllib.request as u; u.urlopen('http://127.0.0.1:8000/readyz', timeout=4)"]
# Others can reach 0.0.0.0, so it starts only with a key, an identity provider, or SKYPOSE_AUTH=off (docs/security.md).
CMD ["skypose", "serve", "--host", "0.0.0.0", "--port", "8000", "--data", "/data"]
