//! The program: options that end it at once, files that it reads again, and its log.
//!
//! | module | subject |
//! | --- | --- |
//! | `openness` | warnings of a server that other machines reach |
//! | `peers` | log lines about peers that break the rules |

#[cfg(unix)]
mod openness;
#[cfg(target_os = "linux")]
mod peers;
mod running;

use running::{Server, TEST_TIMEOUT, program};
#[cfg(unix)]
use rustls::pki_types::{CertificateDer, pem::PemObject};
#[cfg(unix)]
use std::io::{Read, Write};
#[cfg(unix)]
use std::net::TcpStream;
#[cfg(unix)]
use std::process::Command;
#[cfg(unix)]
use std::sync::Arc;
use std::time::{Duration, Instant};

#[test]
fn invalid_values_end_it_with_code_2_and_one_line() {
    for (arguments, words) in [
        (&["--log", "loud"][..], &["log", "loud", "info", "trace"][..]),
        (&["--world-seed", "-1"], &["--world-seed", "-1", "0 to 18446744073709551615"]),
        (&["--threads", "-1"], &["--threads", "-1"]),
        (&["--listen", "0.0.0.0:0"], &["listen", "0.0.0.0:0", "tls-cert", "trusted-proxy", "insecure"]),
        (&["--listen", "[::]:0", "--token-file", "/does/not/exist"], &["listen", "[::]:0", "insecure"]),
        (&["--trusted-proxy", "anybody.example"], &["trusted-proxy", "anybody.example"]),
        (&["--proxy-header", "via"], &["--proxy-header", "via", "x-forwarded-for"]),
        (&["--store", "memory:///x"], &["store", "`memory`", "file:///FOLDER", "s3://", "gs://", "az://"]),
        (&["bake", "--store", "memory:///x"], &["--store", "`memory`", "file:///FOLDER"]),
        (&["--protect", "chunks"], &["--protect", "chunks", "metrics", "world"]),
    ] {
        let output = program().args(arguments).output().unwrap();
        let line = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(2), "{arguments:?}: {line}");
        assert_eq!(line.trim_end().lines().count(), 1, "{arguments:?}: {line}");
        for word in words {
            assert!(line.contains(word), "{arguments:?}: `{line}` lacks `{word}`");
        }
    }
}

#[test]
fn beyond_the_loopback_it_starts_by_an_option() {
    for arguments in [&["--insecure"][..], &["--trusted-proxy", "10.0.0.0/8"]] {
        let server = Server::start(&[&["--listen", "0.0.0.0:0"], arguments].concat());
        assert_eq!(server.scheme, "http");
    }
    let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/http/tls/first");
    let (certificate, key) = (format!("{folder}.crt"), format!("{folder}.key"));
    let server = Server::start(&["--listen", "0.0.0.0:0", "--tls-cert", &certificate, "--tls-key", &key]);
    assert_eq!(server.scheme, "https");
}

/// A value that a deployment passes on without having one. What protects a server is no such value.
#[test]
fn an_empty_variable_is_an_absent_one_unless_it_protects_the_server() {
    let output = |variable: &str, value: &str| {
        // It ends after all options are read: no machine here has the address.
        let mut command = program();
        command.args(["--listen", "192.0.2.1:7580", "--insecure"]).env(variable, value).output().unwrap()
    };
    for variable in
        ["DISK_CACHE", "DISK_MB", "STORE", "STORE_WAIT_MS", "ALLOWED_HOST", "CACHE_MB", "LOG_JSON"]
    {
        let output = output(&format!("TOMBOLO_{variable}"), "");
        let error = String::from_utf8(output.stderr).unwrap();
        assert!(error.contains("cannot listen") && error.contains("address of this machine"), "{error}");
        assert_eq!(output.status.code(), Some(1), "{variable}: {error}");
    }
    for variable in [
        "CONFIG",
        "TOKEN_FILE",
        "TLS_CERT",
        "TLS_KEY",
        "PROTECT",
        "RATE_LIMIT_MS",
        "MAX_SESSIONS_PER_ADDRESS",
    ] {
        assert_eq!(output(&format!("TOMBOLO_{variable}"), "").status.code(), Some(2), "{variable}");
    }
    let output = output("TOMBOLO_CACHE_MB", "1e3");
    let error = String::from_utf8(output.stderr).unwrap();
    assert!(output.status.code() == Some(2) && error.contains("1 to 65536"), "{error}");
}

#[cfg(unix)]
#[test]
fn tokens_are_read_again_on_sighup() {
    let path = std::env::temp_dir().join(format!("tombolo-program-{}.toml", std::process::id()));
    std::fs::write(&path, "first\n").unwrap();
    let server = Server::start(&["--listen", "127.0.0.1:0", "--token-file", path.to_str().unwrap()]);
    assert_eq!((server.live("first"), server.live("second")), (200, 401));
    let reload = |content: &str| {
        std::fs::write(&path, content).unwrap();
        let killed = Command::new("kill").args(["-HUP", &server.child.id().to_string()]).status();
        assert!(killed.unwrap().success());
    };
    reload("[[token]]\nname = \"a\"\ntoken = \"second\"\n");
    let wait_until = |is_so: &dyn Fn() -> bool| {
        let started = Instant::now();
        while !is_so() {
            assert!(started.elapsed() < TEST_TIMEOUT);
            std::thread::sleep(Duration::from_millis(20));
        }
    };
    wait_until(&|| server.live("second") == 200);
    assert_eq!(server.live("first"), 401);
    // An invalid file changes nothing but a metric, and SIGHUP does not end the server.
    let has_failed = |failed: u8| {
        let value = format!("tombolo_reload_failed{{file=\"tokens\"}} {failed}");
        server.get("/metrics", "").contains(&value)
    };
    assert!(has_failed(0));
    reload("[[token]]\nname = 1\n");
    wait_until(&|| has_failed(1));
    assert_eq!(server.live("second"), 200);
    // A good file after a bad one is read.
    reload("[[token]]\nname = \"a\"\ntoken = \"third\"\n");
    wait_until(&|| server.live("third") == 200);
    assert!(has_failed(0) && server.live("second") == 401);
    std::fs::remove_file(path).unwrap();
}

/// Whether a TLS handshake succeeds for a client that trusts one certificate alone.
#[cfg(unix)]
fn has_certificate(address: &str, pem: &str) -> bool {
    get_over_tls(address, pem, "/livez").is_some_and(|reply| reply.starts_with("HTTP/1.1 200"))
}

/// The response to a GET of a client that trusts one certificate alone; none without a handshake.
#[cfg(unix)]
fn get_over_tls(address: &str, pem: &str, path: &str) -> Option<String> {
    let mut roots = rustls::RootCertStore::empty();
    roots.add(CertificateDer::from_pem_slice(pem.as_bytes()).unwrap()).unwrap();
    let config =
        rustls::ClientConfig::builder_with_provider(Arc::new(rustls::crypto::ring::default_provider()))
            .with_safe_default_protocol_versions()
            .unwrap()
            .with_root_certificates(roots)
            .with_no_client_auth();
    let name = rustls::pki_types::ServerName::try_from("localhost").unwrap();
    let mut session = rustls::ClientConnection::new(Arc::new(config), name).unwrap();
    let mut socket = TcpStream::connect(address).unwrap();
    socket.set_read_timeout(Some(TEST_TIMEOUT)).unwrap();
    let mut stream = rustls::Stream::new(&mut session, &mut socket);
    write!(stream, "GET {path} HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n").ok()?;
    let mut reply = Vec::new();
    // The end of the connection may come without that of TLS.
    let _ = stream.read_to_end(&mut reply);
    Some(String::from_utf8_lossy(&reply).into_owned())
}

#[cfg(unix)]
#[test]
fn a_certificate_is_read_again_on_sighup() {
    let pairs = [
        [include_str!("../http/tls/first.crt"), include_str!("../http/tls/first.key")],
        [include_str!("../http/tls/second.crt"), include_str!("../http/tls/second.key")],
    ];
    let folder = std::env::temp_dir().join(format!("tombolo-program-tls-{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    let paths = ["crt", "key"].map(|name| folder.join(name).to_str().unwrap().to_owned());
    let write = |pair: [&str; 2]| {
        for (path, content) in paths.iter().zip(pair) {
            std::fs::write(path, content).unwrap();
        }
    };
    write(pairs[0]);
    let server = Server::start(&["--listen", "127.0.0.1:0", "--tls-cert", &paths[0], "--tls-key", &paths[1]]);
    let serves = |pair: [&str; 2]| has_certificate(&server.address, pair[0]);
    let reload = || {
        let killed = Command::new("kill").args(["-HUP", &server.child.id().to_string()]).status();
        assert!(killed.unwrap().success());
    };
    assert!(serves(pairs[0]) && !serves(pairs[1]));
    // A key of another certificate changes nothing.
    write([pairs[1][0], pairs[0][1]]);
    reload();
    let wait_until = |is_so: &dyn Fn() -> bool| {
        let started = Instant::now();
        while !is_so() {
            assert!(started.elapsed() < TEST_TIMEOUT);
            std::thread::sleep(Duration::from_millis(20));
        }
    };
    let failed = |count: u8| format!("tombolo_reload_failed{{file=\"certificate\"}} {count}");
    wait_until(&|| {
        get_over_tls(&server.address, pairs[0][0], "/metrics").is_some_and(|text| text.contains(&failed(1)))
    });
    assert!(serves(pairs[0]) && !serves(pairs[1]));
    write(pairs[1]);
    reload();
    wait_until(&|| serves(pairs[1]));
    assert!(!serves(pairs[0]));
    std::fs::remove_dir_all(folder).unwrap();
}

/// A pipe without a writer stands for a mount that hangs.
#[cfg(unix)]
#[test]
fn a_file_that_cannot_be_read_to_its_end_is_reported_and_does_not_keep_the_server_from_ending() {
    let path = std::env::temp_dir().join(format!("tombolo-program-hang-{}", std::process::id()));
    std::fs::write(&path, "first\n").unwrap();
    let mut server = Server::start(&["--listen", "127.0.0.1:0", "--token-file", path.to_str().unwrap()]);
    std::fs::remove_file(&path).unwrap();
    assert!(Command::new("mkfifo").arg(&path).status().unwrap().success());
    let signal = |server: &Server, name: &str| {
        assert!(
            Command::new("kill").args([name, &server.child.id().to_string()]).status().unwrap().success()
        );
    };
    signal(&server, "-HUP");
    let started = Instant::now();
    while !server.get("/metrics", "").contains("tombolo_reload_failed{file=\"tokens\"} 1") {
        assert!(started.elapsed() < TEST_TIMEOUT);
        std::thread::sleep(Duration::from_millis(20));
    }
    assert_eq!(server.live("first"), 200);
    signal(&server, "-TERM");
    let started = Instant::now();
    let status = loop {
        if let Some(status) = server.child.try_wait().unwrap() {
            break status;
        }
        assert!(started.elapsed() < TEST_TIMEOUT, "it waits for the read");
        std::thread::sleep(Duration::from_millis(20));
    };
    assert!(status.success());
    std::fs::remove_file(path).unwrap();
}

/// As `systemctl reload` does, also to a server without tokens and TLS.
#[cfg(unix)]
#[test]
fn a_server_without_a_terminal_stays_after_sighup() {
    let server = Server::start(&["--listen", "127.0.0.1:0"]);
    let killed = Command::new("kill").args(["-HUP", &server.child.id().to_string()]).status();
    assert!(killed.unwrap().success());
    // The signal is pending by now: a process that it ends answers no later request.
    assert_eq!(server.live(""), 200);
}

#[test]
fn an_address_that_guesses_has_one_line_in_the_log_and_no_token_is_in_it() {
    let path = std::env::temp_dir().join(format!("tombolo-program-log-{}", std::process::id()));
    std::fs::write(&path, "secret-of-the-server\n").unwrap();
    let server = Server::start(&["--listen", "127.0.0.1:0", "--token-file", path.to_str().unwrap()]);
    for guess in 0..40 {
        assert!([401, 429].contains(&server.live(&format!("guess-{guess}"))));
    }
    let log = server.log();
    std::fs::remove_file(path).unwrap();
    let lines: Vec<_> = log.lines().filter(|line| line.contains("peer breaks the rules")).collect();
    assert_eq!(lines.len(), 1, "{log}");
    assert!(lines[0].contains("address=\"127.0.0.1\"") && lines[0].contains("wrong token"), "{log}");
    assert!(!log.contains("guess-") && !log.contains("secret-of"), "{log}");
}
