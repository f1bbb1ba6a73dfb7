//! TLS: requests, sessions, a new certificate, and peers that do not finish the handshake.

use crate::client::{Server, request_over, welcomed};
use futures_util::FutureExt;
use rustls::crypto::ring;
use rustls::pki_types::pem::PemObject;
use rustls::pki_types::{CertificateDer, ServerName};
use rustls::{ClientConfig, RootCertStore};
use server::ServerConfig;
use server::proxy::{ProxyHeader, TrustedProxies};
use server::tls::Tls;
use std::io;
use std::net::IpAddr;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;
use tokio::io::AsyncWriteExt;
use tokio::net::TcpStream;
use tokio::time::timeout;
use tokio_rustls::TlsConnector;
use tokio_rustls::client::TlsStream;
use tokio_tungstenite::tungstenite::client::IntoClientRequest;

/// Certificates of localhost, valid for a hundred years, and their keys, for these tests only.
const FIRST: [&str; 2] = [include_str!("tls/first.crt"), include_str!("tls/first.key")];
const SECOND: [&str; 2] = [include_str!("tls/second.crt"), include_str!("tls/second.key")];

/// Keys that no server can use: encrypted by `secret` in PKCS #8 and in OpenSSL's older format, and
/// of other kinds.
const ENCRYPTED: [&str; 2] = [include_str!("tls/encrypted.key"), include_str!("tls/encrypted-sec1.key")];
const OTHER_KINDS: [&str; 3] =
    [include_str!("tls/p521.key"), include_str!("tls/secp256k1.key"), include_str!("tls/rsa-1024.key")];

/// A folder with a certificate and its key, removed when dropped.
struct Folder(PathBuf);

impl Folder {
    fn new(name: &str, files: [&str; 2]) -> Self {
        let folder = Self(std::env::temp_dir().join(format!("tombolo-tls-{name}-{}", std::process::id())));
        std::fs::create_dir_all(&folder.0).unwrap();
        folder.write(files);
        folder
    }

    fn write(&self, [certificate, key]: [&str; 2]) {
        std::fs::write(self.path("crt"), certificate).unwrap();
        std::fs::write(self.path("key"), key).unwrap();
    }

    fn path(&self, name: &str) -> PathBuf {
        self.0.join(name)
    }

    fn tls(&self) -> Arc<Tls> {
        Tls::of_options(Some(self.path("crt")), Some(self.path("key"))).unwrap().unwrap()
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.0);
    }
}

/// A connection that accepts this certificate only.
async fn connect(server: &Server, certificate: [&str; 2]) -> io::Result<TlsStream<TcpStream>> {
    connect_over(TcpStream::connect(server.address).await?, certificate).await
}

/// As [`connect`], over a stream on which nothing was read.
async fn connect_over(stream: TcpStream, [certificate, _]: [&str; 2]) -> io::Result<TlsStream<TcpStream>> {
    let mut roots = RootCertStore::empty();
    roots.add(CertificateDer::from_pem_slice(certificate.as_bytes()).unwrap()).unwrap();
    let config = ClientConfig::builder_with_provider(Arc::new(ring::default_provider()))
        .with_safe_default_protocol_versions()
        .unwrap()
        .with_root_certificates(roots)
        .with_no_client_auth();
    TlsConnector::from(Arc::new(config)).connect(ServerName::try_from("localhost").unwrap(), stream).await
}

#[tokio::test]
async fn requests_and_sessions_work_over_tls_and_a_new_certificate_is_taken() {
    let folder = Folder::new("reload", FIRST);
    let tls = folder.tls();
    let config = ServerConfig { tls: Some(Arc::clone(&tls)), threads: 1, ..ServerConfig::default() };
    let server = Server::start_with(config).await;
    let stream = connect(&server, FIRST).await.unwrap();
    let reply = request_over(stream, "GET", &server.path("chunk/4/0/0"), &[]).await;
    assert_eq!((reply.status, reply.header("content-type")), (200, "application/octet-stream"));

    let mut request = "ws://localhost/v1/stream".into_client_request().unwrap();
    request.headers_mut().insert("Sec-WebSocket-Protocol", protocol::SUBPROTOCOL.parse().unwrap());
    let stream = connect(&server, FIRST).await.unwrap();
    assert_eq!(welcomed(request, stream, None).await.1, None);

    assert!(connect(&server, SECOND).await.is_err(), "the control");
    folder.write(SECOND);
    tls.replace(tls.read().unwrap());
    assert!(connect(&server, SECOND).await.is_ok() && connect(&server, FIRST).await.is_err());
    // A certificate with the key of another one changes nothing.
    folder.write([FIRST[0], SECOND[1]]);
    assert!(tls.read().is_err());
    assert!(connect(&server, SECOND).await.is_ok());
}

/// Handshakes of one site wait for each other, and no more of them than the half of the threads
/// run.
#[tokio::test]
async fn a_handshake_waits_for_its_turn() {
    let folder = Folder::new("turns", FIRST);
    let tls = folder.tls();
    let config = ServerConfig { tls: Some(Arc::clone(&tls)), threads: 1, ..ServerConfig::default() };
    let server = Server::start_with(config).await;
    let other = Some(IpAddr::from([10, 0, 0, 1]));
    let mut turns = Vec::new();
    while let Some(turn) = tls.turns().acquire(other).now_or_never() {
        turns.push(turn.unwrap());
    }
    let connecting = tokio::spawn(async move { connect(&server, FIRST).await.is_ok() });
    while tls.turns().sites() < 2 {
        tokio::task::yield_now().await;
    }
    assert!(!connecting.is_finished());
    drop(turns);
    assert!(connecting.await.unwrap());
    // The turn ended with the handshake.
    assert_eq!(tls.turns().sites(), 0);
}

#[tokio::test]
async fn a_peer_that_does_not_finish_the_handshake_is_closed_and_delays_no_client() {
    let folder = Folder::new("silent", FIRST);
    let handshake_timeout = Duration::from_millis(700);
    let config =
        ServerConfig { tls: Some(folder.tls()), threads: 1, handshake_timeout, ..ServerConfig::default() };
    let server = Server::start_with(config).await;
    let mut silent = Vec::new();
    for begun in [&b""[..], &[22, 3, 1], b"GET / HTTP/1.1\r\n\r\n"].into_iter().cycle().take(60) {
        let mut stream = TcpStream::connect(server.address).await.unwrap();
        stream.write_all(begun).await.unwrap();
        silent.push(stream);
    }
    let stream = connect(&server, FIRST).await.unwrap();
    assert_eq!(request_over(stream, "GET", "/livez", &[]).await.status, 200);
    for stream in silent {
        // Closed by the server, with at most an alert.
        assert!(crate::client::read_all(stream).await.len() < 20);
    }
    let stream = connect(&server, FIRST).await.unwrap();
    let text = String::from_utf8(request_over(stream, "GET", "/metrics", &[]).await.body).unwrap();
    for line in [
        "tombolo_connections_failed_total{reason=\"opening_timeout\"} 40",
        "tombolo_connections_failed_total{reason=\"tls_handshake\"} 20",
    ] {
        assert!(text.lines().any(|found| found == line), "{line} is not in {text}");
    }
}

/// Before, a connection of a proxy that was chosen to end in its handshake of TLS kept its place.
#[tokio::test]
async fn clients_of_a_proxy_that_do_not_finish_the_handshake_leave_places_to_others() {
    let folder = Folder::new("places", FIRST);
    // Longer than the test, so that no silent connection ends by itself.
    let handshake_timeout = Duration::from_secs(120);
    let proxies = TrustedProxies::parse(&["127.0.0.1".to_owned()], Some(ProxyHeader::ProxyProtocol)).unwrap();
    let config = ServerConfig {
        tls: Some(folder.tls()),
        threads: 1,
        max_sessions: 4,
        handshake_timeout,
        proxies,
        ..ServerConfig::default()
    };
    let server = Server::start_with(config).await;
    let connect_from = async |client: u8| {
        let mut stream = TcpStream::connect(server.address).await.unwrap();
        let header = format!("PROXY TCP4 192.0.2.{client} 127.0.0.1 4711 443\r\n");
        stream.write_all(header.as_bytes()).await.unwrap();
        stream
    };
    let mut silent = Vec::new();
    for client in 2..14 {
        for _ in 0..40 {
            silent.push(connect_from(client).await);
        }
    }
    for client in 101..111 {
        let asked = async {
            let stream = connect_over(connect_from(client).await, FIRST).await.expect("it has a place");
            request_over(stream, "GET", "/livez", &[]).await.status
        };
        assert_eq!(timeout(handshake_timeout / 4, asked).await.expect("it is answered"), 200);
    }
    drop(silent);
    server.stop().await;
}

#[test]
fn unusable_files_are_named_with_their_option() {
    let folder = Folder::new("unusable", FIRST);
    let (certificate, key) = (folder.path("crt"), folder.path("key"));
    let missing = Path::new("/does/not/exist").to_owned();
    folder.write([FIRST[0], "no key"]);
    std::fs::write(folder.path("empty"), "").unwrap();
    std::fs::write(folder.path("other"), SECOND[1]).unwrap();
    for (certificate, key, words) in [
        (Some(certificate.clone()), None, ["tls-cert", "tls-key FILE"]),
        (None, Some(key.clone()), ["tls-key", "tls-cert FILE"]),
        (Some(missing.clone()), Some(key.clone()), ["tls-cert", "/does/not/exist"]),
        (Some(certificate.clone()), Some(missing), ["tls-key", "/does/not/exist"]),
        (Some(certificate.clone()), Some(key.clone()), ["tls-key", "no private key"]),
        (Some(folder.path("empty")), Some(key), ["tls-cert", "no certificates"]),
        (Some(certificate), Some(folder.path("other")), ["tls-key", "cannot use"]),
    ] {
        let message = Tls::of_options(certificate, key).unwrap_err().to_string();
        assert!(!message.contains('\n'), "{message}");
        for word in words {
            assert!(message.contains(word), "`{message}` lacks `{word}`");
        }
    }
}

#[test]
fn messages_say_which_file_is_wrong_why_and_what_to_do() {
    let garbage = "-----BEGIN CERTIFICATE-----\nAAAA\n-----END CERTIFICATE-----\n";
    let message = |certificate: &str, key: &str| {
        let folder = Folder::new("messages", [certificate, key]);
        let message =
            Tls::of_options(Some(folder.path("crt")), Some(folder.path("key"))).unwrap_err().to_string();
        assert!(!message.contains('\n') && !message.contains("45, 45"), "bytes as numbers: {message}");
        message
    };
    let cut = |pem: &'static str| &pem[..pem.len() / 2];
    let cases = [
        (garbage, FIRST[1], ["tls-cert: ", "no valid X.509 certificate"]),
        (cut(FIRST[0]), FIRST[1], ["tls-cert: ", "no `-----END` line"]),
        (FIRST[0], cut(FIRST[1]), ["tls-key: ", "no `-----END` line"]),
        (FIRST[0], SECOND[1], ["tls-key: ", "the key of another certificate"]),
    ];
    let encrypted = ENCRYPTED.map(|key| (FIRST[0], key, ["tls-key: ", "is encrypted; decrypt it: openssl"]));
    let other = OTHER_KINDS.map(|key| (FIRST[0], key, ["tls-key: ", "ECDSA on P-256 or P-384"]));
    for (certificate, key, words) in cases.into_iter().chain(encrypted).chain(other) {
        let message = message(certificate, key);
        assert!(message.starts_with(words[0]) && message.contains(words[1]), "{words:?}: {message}");
    }
}
