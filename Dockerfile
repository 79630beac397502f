# skypose as an image: PoCL for OpenCL on the CPU, Mesa for OpenGL without a display. Listens on 8000; writes under /data,
# /var/cache/skypose (compiled kernels) and /tmp only, so that its root may be read-only (docs/operations.md).
#   --build-arg NVIDIA=1             also finds the drivers that NVIDIA's container toolkit hands in
#   --build-arg EXTRAS=ray           also holds Ray, for workers on several machines
ARG BASE=debian:bookworm-slim

FROM ${BASE} AS build
RUN apt-get update \
 && DEBIAN_FRONTEND=noninteractive apt-get install -y --no-install-recommends python3 python3-venv ca-certificates \
 && apt-get clean && rm -rf /var/lib/apt/lists/*
RUN python3 -m venv /opt/skypose
WORKDIR /src
# The packages first: they change less often than the code, and the layer is kept. Each is checked against its hash.
COPY requirements.lock ./
RUN /opt/skypose/bin/pip install --no-cache-dir --require-hashes --no-deps -r requirements.lock
ARG EXTRAS=""
COPY requirements*.lock ./
RUN for extra in $EXTRAS; do \
      /opt/skypose/bin/pip install --no-cache-dir --require-hashes --no-deps -r "requirements-$extra.lock" || exit; \
    done
COPY pyproject.toml README.md LICENSE ./
COPY gpu gpu
COPY service service
COPY deploy/sbom /opt/skypose/bin/skypose-sbom
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
# Compiled kernels are kept out of /data: they are worth nothing on another machine.
ENV PATH=/opt/skypose/bin:$PATH \
    PYTHONDONTWRITEBYTECODE=1 \
    PYTHONUNBUFFERED=1 \
    XDG_CACHE_HOME=/var/cache/skypose \
    POCL_CACHE_DIR=/var/cache/skypose/pocl

# The toolkit brings NVIDIA's drivers when the container starts, but not always the two files by which the loaders find
# them. What is empty here is to the toolkit as if it were not there.
ARG NVIDIA=""
RUN [ -z "$NVIDIA" ] || { \
      install -d /etc/OpenCL/vendors /usr/share/glvnd/egl_vendor.d \
      && echo libnvidia-opencl.so.1 >/etc/OpenCL/vendors/nvidia.icd \
      && echo '{"file_format_version": "1.0.0", "ICD": {"library_path": "libEGL_nvidia.so.0"}}' \
           >/usr/share/glvnd/egl_vendor.d/10_nvidia.json; }
ENV NVIDIA_VISIBLE_DEVICES=${NVIDIA:+all} \
    NVIDIA_DRIVER_CAPABILITIES=${NVIDIA:+compute,graphics,utility} \
    CUDA_CACHE_PATH=/var/cache/skypose/nvidia
COPY --from=build /opt/skypose /opt/skypose
# What is in this image, Debian's packages and Python's, as CycloneDX.
RUN install -d /usr/share/skypose && skypose-sbom --out /usr/share/skypose/sbom.cdx.json
USER skypose
WORKDIR /data
VOLUME ["/data", "/var/cache/skypose"]
EXPOSE 8000
HEALTHCHECK --interval=10s --timeout=5s --start-period=60s --retries=3 \
  CMD ["python3", "-c", "import urllib.request as u; u.urlopen('http://127.0.0.1:8000/readyz', timeout=4)"]
# Others can reach 0.0.0.0, so it starts only with a key, an identity provider, or SKYPOSE_AUTH=off (docs/security.md).
CMD ["skypose", "serve", "--host", "0.0.0.0", "--port", "8000", "--data", "/data"]
