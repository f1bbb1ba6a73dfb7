# An image of tombolo-server: `docker build -t tombolo-server .`
FROM rust:1.95-bookworm AS build
WORKDIR /src
COPY . .
RUN cargo build --locked --profile dist --bin tombolo-server

FROM debian:bookworm-slim
COPY --from=build /src/target/dist/tombolo-server /usr/local/bin/
# Of public certificate authorities, for TLS to a store or a collector of traces.
COPY --from=build /etc/ssl/certs/ca-certificates.crt /etc/ssl/certs/
# The folder of a shared store, for a volume; one on another machine is given by its URL.
RUN install -d -o 65532 -g 65532 /store
# Nothing else of the image is written at run time, so it runs with a read-only root.
USER 65532:65532
# A published port of a container is beyond the loopback, so one of these has to be given too:
# TOMBOLO_TRUSTED_PROXY of the proxy in front, TOMBOLO_TLS_CERT and TOMBOLO_TLS_KEY, or
# TOMBOLO_INSECURE=true.
ENV TOMBOLO_LISTEN=0.0.0.0:7580 TOMBOLO_LOG_JSON=true
EXPOSE 7580
STOPSIGNAL SIGTERM
# The image has no HTTP client; bash opens the connection.
HEALTHCHECK --interval=5s --timeout=2s --start-period=5s --retries=3 \
    CMD ["bash", "-c", "exec 3<>/dev/tcp/127.0.0.1/7580 && printf 'GET /livez HTTP/1.0\\r\\n\\r\\n' >&3 && head -n 1 <&3 | grep -q ' 200 '"]
ENTRYPOINT ["/usr/local/bin/tombolo-server"]
