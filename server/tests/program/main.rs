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

use running::{Server, TEST_TIMEOUT, peer_lines, program};
#[cfg(unix)]
use rustls::pki_types::{CertificateDer, pem::PemObject};
use std::io::{BufRead, BufReader, Read, Write};
use std::net::{TcpListener, TcpStream};
#[cfg(unix)]
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};
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
        (&["--store", "/does/not/exist"], &["store", "/does/not/exist", "create it"]),
        (&["bake", "--store", "/does/not/exist"], &["--store", "/does/not/exist", "create it"]),
        (&["bake", "--store", "s3:/bucket"], &["--store", "`s3:/bucket`", "one slash", "s3://BUCKET"]),
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
    assert_eq!((server.upgrade("first"), server.upgrade("second")), (101, 401));
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
    // A stolen token that was withdrawn begins no session.
    assert_eq!((server.upgrade("first"), server.upgrade("second")), (401, 101));
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
fn an_address_that_guesses_is_in_the_log_with_its_events_and_no_token_is() {
    let path = std::env::temp_dir().join(format!("tombolo-program-log-{}", std::process::id()));
    std::fs::write(&path, "secret-of-the-server\n").unwrap();
    let server = Server::start(&["--listen", "127.0.0.1:0", "--token-file", path.to_str().unwrap()]);
    for guess in 0..40 {
        assert!([401, 429].contains(&server.live(&format!("guess-{guess}"))));
    }
    let log = server.log();
    std::fs::remove_file(path).unwrap();
    let lines = peer_lines(&log);
    assert!(lines.iter().all(|(line, _)| line.contains("address=\"127.0.0.1\"")), "{log}");
    for reason in ["wrong token", "token guesses"] {
        let first = lines.iter().find(|(line, _)| line.contains(reason));
        assert_eq!(first.map(|(_, events)| *events), Some(1), "{log}");
    }
    // What it only counted is written before it ends, unless it is killed.
    assert!(!cfg!(unix) || lines.iter().map(|(_, events)| events).sum::<u64>() == 40, "{log}");
    assert!(!log.contains("guess-") && !log.contains("secret-of"), "{log}");
}

#[test]
fn an_address_with_an_expired_token_is_in_the_log_with_its_events() {
    let path = std::env::temp_dir().join(format!("tombolo-program-expired-{}", std::process::id()));
    let list = "[[token]]\nname = \"old\"\ntoken = \"once-valid\"\nexpires = 2020-01-01T00:00:00Z\n";
    std::fs::write(&path, list).unwrap();
    let server = Server::start(&["--listen", "127.0.0.1:0", "--token-file", path.to_str().unwrap()]);
    for _ in 0..20 {
        assert_eq!(server.live("once-valid"), 401, "it is no guess");
    }
    let log = server.log();
    std::fs::remove_file(path).unwrap();
    let lines = peer_lines(&log);
    let about = "address=\"127.0.0.1\" reason=\"expired token\"";
    assert!(lines.iter().all(|(line, _)| line.contains(about)), "{log}");
    assert_eq!(lines.first().map(|(_, events)| *events), Some(1), "{log}");
    assert!(!cfg!(unix) || lines.iter().map(|(_, events)| events).sum::<u64>() == 20, "{log}");
    assert!(!log.contains("once-valid"), "{log}");
}

/// An engine that answers every request with 403. Returns its address, and what counts the lists.
fn refusing_store() -> (String, Arc<AtomicU32>) {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let (address, lists) = (listener.local_addr().unwrap(), Arc::new(AtomicU32::new(0)));
    let counted = Arc::clone(&lists);
    std::thread::spawn(move || {
        for mut stream in listener.incoming().flatten() {
            let mut lines = BufReader::new(&stream).lines().map_while(Result::ok);
            let is_list = lines.next().is_some_and(|line| line.contains("list-type"));
            lines.take_while(|line| !line.is_empty()).for_each(drop);
            let _ =
                stream.write_all(b"HTTP/1.1 403 Forbidden\r\nContent-Length: 0\r\nConnection: close\r\n\r\n");
            counted.fetch_add(u32::from(is_list), Ordering::Relaxed);
        }
    });
    (format!("http://{address}"), lists)
}

/// As S3 answers for objects that do not exist to a client that may not list the bucket.
#[test]
fn a_store_without_the_right_to_list_has_one_warning_and_is_asked_on() {
    let (endpoint, lists) = refusing_store();
    let server = Server::start_with(
        &["--listen", "127.0.0.1:0", "--store", "s3://bucket/x", "--store-wait-ms", "10000"],
        &[
            ("AWS_ENDPOINT", &endpoint),
            ("AWS_ALLOW_HTTP", "true"),
            ("AWS_ACCESS_KEY_ID", "key"),
            ("AWS_SECRET_ACCESS_KEY", "secret"),
            ("NO_PROXY", "127.0.0.1"),
        ],
    );
    let digest = terrain::Land::new(1).digest();
    for x in 0..8 {
        let reply = server.get(&format!("/v1/{digest}/chunk/2/{x}/0"), "");
        assert!(reply.starts_with("HTTP/1.1 200"), "{reply}");
    }
    // A list that failed is tried again within the timeout of a test.
    let started = Instant::now();
    while lists.load(Ordering::Relaxed) < 2 {
        assert!(started.elapsed() < TEST_TIMEOUT);
        std::thread::sleep(Duration::from_millis(20));
    }
    let metrics = server.get("/metrics", "");
    for line in
        ["tombolo_store_reads_total{outcome=\"miss\"} 8", "tombolo_store_reads_total{outcome=\"failed\"} 0"]
    {
        assert!(metrics.contains(line), "{metrics}");
    }
    let log = server.log();
    for words in ["refuses reads", "cannot list the regions"] {
        assert_eq!(log.lines().filter(|line| line.contains(words)).count(), 1, "{log}");
    }
}

/// The files of a folder and those below it.
#[cfg(unix)]
fn files(folder: &Path) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
    entries
        .flat_map(|entry| if entry.path().is_dir() { files(&entry.path()) } else { vec![entry.path()] })
        .collect()
}

/// The area would take minutes.
#[cfg(unix)]
#[test]
fn a_bake_that_is_stopped_ends_with_one_line_and_code_143_and_has_whole_packs() {
    let folder = std::env::temp_dir().join(format!("tombolo-program-bake-{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    for signal in ["-TERM", "-INT"] {
        let mut bake = program()
            .args(["bake", "--levels", "2", "--area=-200000,-200000,200000,200000", "--threads", "1"])
            .arg("--store")
            .arg(&folder)
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        let before = files(&folder).len();
        let started = Instant::now();
        while files(&folder).len() == before {
            assert!(started.elapsed() < TEST_TIMEOUT);
            std::thread::sleep(Duration::from_millis(5));
        }
        assert!(Command::new("kill").args([signal, &bake.id().to_string()]).status().unwrap().success());
        let mut log = String::new();
        bake.stderr.take().unwrap().read_to_string(&mut log).unwrap();
        assert_eq!(bake.wait().unwrap().code(), Some(143), "{log}");
        let files = files(&folder);
        assert!(files.iter().all(|file| file.ends_with("pack")), "{files:?}");
        let last = format!("tombolo-server: {} packs written; run it again to go on", files.len() - before);
        assert_eq!(log.lines().last(), Some(&*last), "{log}");
    }
    std::fs::remove_dir_all(folder).unwrap();
}
