//! The words of a browser: WGSL, translated by Tint for SwiftShader.
//!
//! A page is served on the loopback interface; headless Chromium loads it, runs the pass and posts
//! the words back.

use crate::digest::child::{ChildGuard, Scratch};
use crate::digest::probes::Probe;
use anyhow::{Context, Result, anyhow, bail};
use shaders::Shader;
use shaders::layout::{FILL_WORKGROUP, PROBE_WORDS, World};
use std::io::{BufRead, BufReader, ErrorKind, Read, Write};
use std::net::{TcpListener, TcpStream};
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};
use terrain::Land;

/// A browser starts within seconds and computes all probes in a few more.
const TIME_LIMIT: Duration = Duration::from_secs(120);

/// A stalled request must not block the next.
const REQUEST_LIMIT: Duration = Duration::from_secs(20);

/// Longest line of a request's head, and most of them.
const MAX_LINE: u64 = 16 << 10;
const MAX_LINES: usize = 100;

const PAGE: &str = include_str!("browser.html");

#[derive(Debug)]
pub enum Outcome {
    /// The words, and the name of the adapter.
    Words {
        /// As `probe_heights` writes them.
        words: Vec<i32>,
        /// For people.
        adapter: String,
    },
    /// The browser has no WebGPU here.
    NoWebGpu(String),
}

/// Runs a pass over all probes in a browser.
///
/// # Errors
/// The browser cannot be started, ends early, reports a failure, or takes too long.
pub fn words(program: &Path, shader: &Shader, land: &Land, probes: &[Probe]) -> Result<Outcome> {
    let deadline = Instant::now() + TIME_LIMIT;
    let listener = TcpListener::bind("127.0.0.1:0").context("no port for the page")?;
    listener.set_nonblocking(true).context("no port for the page")?;
    let address = listener.local_addr().context("no port for the page")?;
    // An own profile, independent of settings and running browsers. Temporary files go there too.
    // The name is short: paths of sockets in it are limited to about 100 characters.
    let profile = Scratch::new("tombolo-lab-browser")?;
    let temporary = profile.path().join("t");
    std::fs::create_dir_all(&temporary)
        .with_context(|| format!("`{}` cannot be created", temporary.display()))?;
    let mut command = Command::new(program);
    command
        // The sandbox needs rights that containers lack; the only page it opens is ours.
        .args(["--headless=new", "--no-sandbox", "--no-first-run", "--disable-extensions"])
        .args(["--enable-unsafe-webgpu", "--use-webgpu-adapter=swiftshader"])
        .arg(format!("--user-data-dir={}", profile.path().display()))
        .arg(format!("http://{address}/"));
    command.env("TMPDIR", &temporary).stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null());
    // Dropped, and so ended, before its profile.
    let mut browser = ChildGuard::start(&mut command)
        .with_context(|| format!("`{}` cannot be started", program.display()))?;

    let world = World::from(land.parameters());
    let served = Served { shader, world: bytemuck::bytes_of(&world), probes: bytemuck::cast_slice(probes) };
    let mut adapter = String::from("an unnamed adapter");
    while Instant::now() < deadline {
        match listener.accept() {
            Ok((stream, _)) => {
                // Browsers open connections that they do not use.
                let Ok(Some(Post { path, body })) = served.respond(&stream) else { continue };
                match path.as_str() {
                    "/adapter" => adapter = text(&body),
                    "/no-webgpu" => return Ok(Outcome::NoWebGpu(text(&body))),
                    "/words" => return Ok(Outcome::Words { words: as_words(&body), adapter }),
                    _ => bail!("the page failed: {}", text(&body)),
                }
            }
            Err(error) if error.kind() == ErrorKind::WouldBlock => {
                if let Some(status) = browser.child().try_wait()? {
                    bail!("the browser ended ({status}) without a result");
                }
                std::thread::sleep(Duration::from_millis(5));
            }
            Err(error) => return Err(error).context("the page cannot be served"),
        }
    }
    bail!("no result within {} s", TIME_LIMIT.as_secs())
}

/// Resources of the page.
struct Served<'a> {
    shader: &'a Shader,
    world: &'a [u8],
    probes: &'a [u8],
}

/// A POST of the page.
struct Post {
    path: String,
    body: Vec<u8>,
}

impl Served<'_> {
    /// Answers one request, one per connection; returns a POST.
    fn respond(&self, stream: &TcpStream) -> Result<Option<Post>> {
        stream.set_nonblocking(false)?;
        stream.set_read_timeout(Some(REQUEST_LIMIT))?;
        stream.set_write_timeout(Some(REQUEST_LIMIT))?;
        let (method, path, length) = {
            let mut reader = BufReader::new(stream);
            let head = Head::read(&mut reader)?;
            if head.method == "POST" {
                // The largest body is that of `/words`.
                let limit = self.probes.len() / size_of::<Probe>() * PROBE_WORDS * 4;
                if head.length > limit.max(MAX_LINE as usize) {
                    bail!("a body of {} bytes", head.length);
                }
                let mut body = vec![0; head.length];
                reader.read_exact(&mut body)?;
                respond(stream, "204 No Content", "text/plain", b"")?;
                return Ok(Some(Post { path: head.path, body }));
            }
            (head.method, head.path, head.length)
        };
        match (method.as_str(), path.as_str(), length) {
            ("GET", "/", 0) => {
                let page = PAGE
                    .replace("{{WORKGROUP}}", &FILL_WORKGROUP.to_string())
                    .replace("{{WORDS}}", &PROBE_WORDS.to_string())
                    .replace("{{ENTRY}}", self.shader.entry_points[0].name);
                respond(stream, "200 OK", "text/html; charset=utf-8", page.as_bytes())?;
            }
            ("GET", "/shader", 0) => {
                respond(stream, "200 OK", "text/plain; charset=utf-8", self.shader.wgsl.as_bytes())?;
            }
            ("GET", "/world", 0) => respond(stream, "200 OK", "application/octet-stream", self.world)?,
            ("GET", "/probes", 0) => respond(stream, "200 OK", "application/octet-stream", self.probes)?,
            _ => respond(stream, "404 Not Found", "text/plain", b"")?,
        }
        Ok(None)
    }
}

/// The used part of a request's head.
struct Head {
    method: String,
    path: String,
    length: usize,
}

impl Head {
    fn read(reader: &mut impl BufRead) -> Result<Self> {
        let request = line(reader)?;
        let mut parts = request.split(' ');
        let (Some(method), Some(path)) = (parts.next(), parts.next()) else { bail!("no request") };
        let (method, path) = (method.to_owned(), path.to_owned());
        let mut length = 0;
        for _ in 0..MAX_LINES {
            let line = line(reader)?;
            if line.is_empty() {
                return Ok(Self { method, path, length });
            }
            if let Some((name, value)) = line.split_once(':')
                && name.eq_ignore_ascii_case("content-length")
            {
                length = value.trim().parse()?;
            }
        }
        bail!("a head of more than {MAX_LINES} lines")
    }
}

fn line(reader: &mut impl BufRead) -> Result<String> {
    let mut line = String::new();
    reader.take(MAX_LINE).read_line(&mut line)?;
    line.strip_suffix("\r\n").map(str::to_owned).ok_or_else(|| anyhow!("a line without end"))
}

fn respond(mut stream: &TcpStream, status: &str, kind: &str, body: &[u8]) -> std::io::Result<()> {
    let length = body.len();
    write!(
        stream,
        "HTTP/1.1 {status}\r\nContent-Type: {kind}\r\nContent-Length: {length}\r\nConnection: close\r\n\r\n"
    )?;
    stream.write_all(body)
}

fn as_words(body: &[u8]) -> Vec<i32> {
    body.chunks_exact(4).map(|word| i32::from_le_bytes([word[0], word[1], word[2], word[3]])).collect()
}

fn text(body: &[u8]) -> String {
    String::from_utf8_lossy(body).lines().map(str::trim).collect::<Vec<_>>().join("; ")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn heads_are_read_to_their_end_and_malformed_ones_rejected() {
        let mut request: &[u8] = b"POST /words HTTP/1.1\r\nHost: a\r\ncontent-LENGTH: 12\r\n\r\nbody";
        let head = Head::read(&mut request).unwrap();
        assert_eq!((head.method.as_str(), head.path.as_str(), head.length), ("POST", "/words", 12));
        assert_eq!(request, b"body");
        let endless = "GET / HTTP/1.1\r\n".to_owned() + &"a: b\r\n".repeat(200);
        for bad in ["", "GET\r\n\r\n", "GET / HTTP/1.1\r\ncontent-length: many\r\n\r\n", &endless] {
            assert!(Head::read(&mut bad.as_bytes()).is_err(), "{bad:?}");
        }
    }
}
