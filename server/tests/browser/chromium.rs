//! Headless Chromium over the Chrome DevTools Protocol:
//! <https://chromedevtools.github.io/devtools-protocol/>.

use futures_util::{SinkExt, StreamExt};
use serde_json::{Value, json};
use std::io::{BufRead, BufReader};
use std::path::PathBuf;
use std::process::{Child, Command, Stdio};
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::{Duration, Instant};
use tokio::net::TcpStream;
use tokio_tungstenite::tungstenite::Message;
use tokio_tungstenite::tungstenite::protocol::WebSocketConfig;
use tokio_tungstenite::{MaybeTlsStream, WebSocketStream, connect_async_with_config};

/// Message without a browser.
pub const MISSING: &str =
    "no Chromium is on the path, so the page is not tested in a browser; install `chromium`";

/// Timeout of every wait. Only a failure reaches it.
const TIMEOUT: Duration = Duration::from_secs(90);

/// Polling interval of the page.
const POLL_INTERVAL: Duration = Duration::from_millis(50);

/// A browser process with its own profile; killed and cleaned up on drop.
pub struct Browser {
    child: Child,
    profile: PathBuf,
    address: String,
}

impl Browser {
    pub fn start() -> Self {
        static NUMBER: AtomicU32 = AtomicU32::new(0);
        let number = NUMBER.fetch_add(1, Ordering::Relaxed);
        // A short name: paths of sockets are limited to about a hundred bytes.
        let profile = std::env::temp_dir().join(format!("tombolo-page-{}-{number}", std::process::id()));
        std::fs::create_dir_all(&profile).unwrap();
        let mut child = Command::new(installed_browser::chromium().expect(MISSING))
            // The sandbox needs privileges that containers lack; only trusted pages are opened.
            .args([
                "--headless=new",
                "--no-sandbox",
                "--no-first-run",
                "--disable-extensions",
                "--disable-gpu",
            ])
            .args(["--remote-debugging-port=0", "--force-device-scale-factor=1", "--hide-scrollbars"])
            .arg(format!("--user-data-dir={}", profile.display()))
            .arg("about:blank")
            .env("TMPDIR", &profile)
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(Stdio::piped())
            .spawn()
            .expect("the browser starts");
        let mut output = BufReader::new(child.stderr.take().unwrap()).lines();
        let address = output
            .by_ref()
            .map_while(Result::ok)
            .find_map(|line| line.strip_prefix("DevTools listening on ").map(str::to_owned))
            .expect("the browser prints its address");
        // Drains the output, so that the browser does not block on it.
        std::thread::spawn(move || output.for_each(drop));
        Self { child, profile, address }
    }

    /// A new tab, whose errors are recorded from the start.
    pub async fn tab(&self) -> Tab {
        // A screenshot is one message of a few megabytes.
        let config =
            WebSocketConfig::default().max_message_size(Some(64 << 20)).max_frame_size(Some(64 << 20));
        let (socket, _) =
            connect_async_with_config(self.address.as_str(), Some(config), false).await.unwrap();
        let mut tab = Tab { socket, session: None, next: 0, faults: Vec::new(), requests: Vec::new() };
        let target = tab.call("Target.createTarget", json!({ "url": "about:blank" })).await;
        let attach = json!({ "targetId": target["targetId"], "flatten": true });
        let attached = tab.call("Target.attachToTarget", attach).await;
        tab.session = Some(attached["sessionId"].as_str().unwrap().to_owned());
        for domain in ["Page", "Runtime", "Log", "Network"] {
            tab.call(&format!("{domain}.enable"), json!({})).await;
        }
        tab
    }
}

impl Drop for Browser {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
        // Its child processes end slightly later and write to the profile until then.
        for _ in 0..50 {
            if std::fs::remove_dir_all(&self.profile).is_ok() || !self.profile.exists() {
                return;
            }
            std::thread::sleep(Duration::from_millis(20));
        }
    }
}

/// One page.
pub struct Tab {
    socket: WebSocketStream<MaybeTlsStream<TcpStream>>,
    session: Option<String>,
    next: u64,
    faults: Vec<String>,
    /// URLs of all network requests.
    pub requests: Vec<String>,
}

impl Tab {
    /// Calls a method and returns its result.
    pub async fn call(&mut self, method: &str, params: Value) -> Value {
        self.next += 1;
        let mut message = json!({ "id": self.next, "method": method, "params": params });
        if let Some(session) = &self.session {
            message["sessionId"] = session.as_str().into();
        }
        self.socket.send(Message::text(message.to_string())).await.unwrap();
        let answer = async {
            loop {
                let message = self.next_message().await;
                if message["id"] == self.next {
                    assert!(message.get("error").is_none(), "{method}: {}", message["error"]);
                    return message["result"].clone();
                }
                self.note(&message);
            }
        };
        tokio::time::timeout(TIMEOUT, answer).await.unwrap_or_else(|_| panic!("{method} is not answered"))
    }

    async fn next_message(&mut self) -> Value {
        loop {
            match self.socket.next().await {
                Some(Ok(Message::Text(text))) => return serde_json::from_str(&text).unwrap(),
                Some(Ok(_)) => {}
                other => panic!("the browser went away: {other:?}"),
            }
        }
    }

    /// Records errors and requests from events.
    fn note(&mut self, event: &Value) {
        let params = &event["params"];
        match event["method"].as_str().unwrap_or_default() {
            "Runtime.exceptionThrown" => self.faults.push(params["exceptionDetails"].to_string()),
            "Runtime.consoleAPICalled"
                if matches!(params["type"].as_str(), Some("error" | "warning" | "assert")) =>
            {
                self.faults.push(params["args"].to_string());
            }
            "Log.entryAdded" if matches!(params["entry"]["level"].as_str(), Some("error" | "warning")) => {
                self.faults.push(params["entry"].to_string());
            }
            "Network.requestWillBeSent" => {
                self.requests.extend(params["request"]["url"].as_str().map(str::to_owned));
            }
            "Network.responseReceived" if params["response"]["status"].as_u64() >= Some(400) => {
                self.faults.push(format!("{} {}", params["response"]["status"], params["response"]["url"]));
            }
            _ => {}
        }
    }

    /// Loads a URL, also if only its fragment differs, and waits for the load.
    pub async fn open(&mut self, url: &str) {
        self.call("Page.navigate", json!({ "url": "about:blank" })).await;
        self.wait_for("location.href === 'about:blank'", "an empty page").await;
        let started = self.call("Page.navigate", json!({ "url": url })).await;
        assert!(started.get("errorText").is_none(), "{url}: {}", started["errorText"]);
        self.wait_for("location.href !== 'about:blank' && document.readyState === 'complete'", url).await;
    }

    /// The value of a script; promises are awaited.
    pub async fn evaluate(&mut self, script: &str) -> Value {
        let params = json!({ "expression": script, "returnByValue": true, "awaitPromise": true });
        let result = self.call("Runtime.evaluate", params).await;
        assert!(result.get("exceptionDetails").is_none(), "{script}: {}", result["exceptionDetails"]);
        result["result"]["value"].clone()
    }

    /// Waits until a script returns `true`.
    pub async fn wait_for(&mut self, script: &str, what: &str) {
        let start = Instant::now();
        // During a navigation scripts fail with an exception.
        let guarded =
            format!("(() => {{ try {{ return Boolean({script}); }} catch {{ return false; }} }})()");
        while self.evaluate(&guarded).await != true {
            if start.elapsed() > TIMEOUT {
                let page = self
                    .evaluate(
                        "document.body.innerText + JSON.stringify(document.getElementById('relief').dataset)",
                    )
                    .await;
                panic!(
                    "timed out waiting for {what}; text of the page: {page}; errors: {:?}",
                    &self.faults[..self.faults.len().min(3)]
                );
            }
            tokio::time::sleep(POLL_INTERVAL).await;
        }
    }

    /// Errors since the last call.
    pub fn take_errors(&mut self) -> Vec<String> {
        std::mem::take(&mut self.faults)
    }

    /// Sets the size of the screen in CSS pixels, and whether it is a phone.
    pub async fn resize(&mut self, width: u32, height: u32, is_phone: bool) {
        let params = json!({ "width": width, "height": height, "deviceScaleFactor": 1, "mobile": is_phone });
        self.call("Emulation.setDeviceMetricsOverride", params).await;
    }

    /// Sets a user preference as a CSS media feature.
    pub async fn prefer(&mut self, feature: &str, value: &str) {
        let features = json!([{ "name": feature, "value": value }]);
        self.call("Emulation.setEmulatedMedia", json!({ "features": features })).await;
    }

    /// Drags with the left button in several steps.
    pub async fn drag(&mut self, from: (f64, f64), to: (f64, f64)) {
        self.mouse("mousePressed", from, json!({ "button": "left", "buttons": 1, "clickCount": 1 })).await;
        for step in 1..=4 {
            let share = f64::from(step) / 4.0;
            let place = (from.0 + (to.0 - from.0) * share, from.1 + (to.1 - from.1) * share);
            self.mouse("mouseMoved", place, json!({ "button": "left", "buttons": 1 })).await;
        }
        self.mouse("mouseReleased", to, json!({ "button": "left", "clickCount": 1 })).await;
    }

    /// Turns the wheel at a position; negative is away from the user.
    pub async fn wheel(&mut self, at: (f64, f64), units: f64) {
        self.mouse("mouseWheel", at, json!({ "deltaX": 0, "deltaY": units })).await;
    }

    /// Touches with two fingers at a distance around a position, and moves them apart or together.
    pub async fn pinch(&mut self, (x, y): (f64, f64), from: f64, to: f64) {
        self.call("Emulation.setTouchEmulationEnabled", json!({ "enabled": true, "maxTouchPoints": 2 }))
            .await;
        let fingers =
            |away: f64| json!([{ "x": x - away, "y": y, "id": 1 }, { "x": x + away, "y": y, "id": 2 }]);
        self.touch("touchStart", fingers(from)).await;
        for step in 1..=4 {
            self.touch("touchMove", fingers(from + (to - from) * f64::from(step) / 4.0)).await;
        }
        self.touch("touchEnd", json!([])).await;
    }

    async fn touch(&mut self, kind: &str, points: Value) {
        self.call("Input.dispatchTouchEvent", json!({ "type": kind, "touchPoints": points })).await;
    }

    async fn mouse(&mut self, kind: &str, (x, y): (f64, f64), more: Value) {
        let mut params = json!({ "type": kind, "x": x, "y": y });
        for (name, value) in more.as_object().unwrap() {
            params[name] = value.clone();
        }
        self.call("Input.dispatchMouseEvent", params).await;
    }

    /// Presses and releases a key.
    pub async fn key(&mut self, key: &str) {
        for kind in ["rawKeyDown", "keyUp"] {
            self.call("Input.dispatchKeyEvent", json!({ "type": kind, "key": key })).await;
        }
    }

    /// A screenshot as PNG.
    pub async fn screenshot(&mut self) -> Vec<u8> {
        let shot = self.call("Page.captureScreenshot", json!({ "format": "png" })).await;
        base64(shot["data"].as_str().unwrap())
    }
}

/// RFC 4648, section 4.
fn base64(text: &str) -> Vec<u8> {
    let (mut bytes, mut bits, mut count) = (Vec::with_capacity(text.len() * 3 / 4), 0u32, 0);
    for letter in text.bytes().take_while(|letter| *letter != b'=') {
        let value = match letter {
            b'A'..=b'Z' => letter - b'A',
            b'a'..=b'z' => letter - b'a' + 26,
            b'0'..=b'9' => letter - b'0' + 52,
            b'+' => 62,
            b'/' => 63,
            _ => panic!("{letter} is not base64"),
        };
        bits = bits << 6 | u32::from(value);
        count += 6;
        if count >= 8 {
            count -= 8;
            bytes.push((bits >> count) as u8);
        }
    }
    bytes
}
