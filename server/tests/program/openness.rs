//! Warnings of a server that other machines reach.

use crate::running::{Server, TEST_TIMEOUT};
use std::io::{Read, Write};
use std::net::TcpStream;

const NO_TLS: &str = "without TLS";
const NO_TOKENS: &str = "without tokens";

/// Where a server listens, groups of its options, and its warnings.
type Case<'a> = (&'a str, &'a [&'a [&'a str]], &'a [&'a str]);

/// Waits for the answer to a connection, which a server accepts after its warnings: a page, or an
/// error of TLS.
fn wait_for_answer(server: &Server) {
    let mut stream = TcpStream::connect(&server.address).unwrap();
    stream.set_read_timeout(Some(TEST_TIMEOUT)).unwrap();
    stream.write_all(b"GET /livez HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n").unwrap();
    let mut answer = [0; 1];
    assert_eq!(stream.read(&mut answer).unwrap(), 1);
}

#[test]
fn a_server_beyond_the_loopback_warns_of_what_it_lacks() {
    let path = std::env::temp_dir().join(format!("tombolo-program-open-{}", std::process::id()));
    std::fs::write(&path, "secret-of-the-server\n").unwrap();
    let tokens = ["--token-file", path.to_str().unwrap()];
    let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/http/tls/first");
    let (certificate, key) = (format!("{folder}.crt"), format!("{folder}.key"));
    let tls = ["--tls-cert", certificate.as_str(), "--tls-key", &key];
    let (proxy, insecure) = (["--trusted-proxy", "10.0.0.0/8"], ["--insecure"]);
    let cases: [Case<'_>; 7] = [
        ("0.0.0.0:0", &[&insecure], &[NO_TLS, NO_TOKENS]),
        ("0.0.0.0:0", &[&insecure, &tokens], &[NO_TLS]),
        ("0.0.0.0:0", &[&tls], &[NO_TOKENS]),
        ("0.0.0.0:0", &[&tls, &tokens], &[]),
        ("0.0.0.0:0", &[&proxy], &[NO_TOKENS]),
        ("0.0.0.0:0", &[&proxy, &tokens], &[]),
        // The control: on the loopback it lacks nothing.
        ("127.0.0.1:0", &[], &[]),
    ];
    for (listen, options, expected) in cases {
        let arguments = [&["--listen", listen][..], &options.concat()].concat();
        let server = Server::start(&arguments);
        wait_for_answer(&server);
        let log = server.log();
        for warning in [NO_TLS, NO_TOKENS] {
            let lines = log.lines().filter(|line| line.contains("WARN") && line.contains(warning)).count();
            assert_eq!(lines, usize::from(expected.contains(&warning)), "{arguments:?}, {warning}: {log}");
        }
    }
    std::fs::remove_file(path).unwrap();
}
