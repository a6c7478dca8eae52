# The command line with all file formats but FBX export, and the studio. docs/systems.md says how to run it.
FROM python:3.13-slim AS build
WORKDIR /source
COPY pyproject.toml README.md LICENSE THIRD_PARTY.md ./
COPY src src
RUN python -m pip wheel --no-cache-dir --no-deps --wheel-dir /wheels .

FROM python:3.13-slim
COPY constraints.txt /wheels/
COPY --from=build /wheels /wheels
RUN python -m pip install --no-cache-dir --constraint /wheels/constraints.txt \
      "$(echo /wheels/mimesh-*.whl)[viewer,compressed,fbx,usd,video]" \
    && useradd --create-home --uid 1000 mimesh && mkdir /data && chown mimesh /data
USER 1000
WORKDIR /data
EXPOSE 8765
ENTRYPOINT ["mimesh"]
CMD ["--help"]
