//! Headless Chromium, driven by chromiumoxide over the Chrome DevTools Protocol:
//! <https://chromedevtools.github.io/devtools-protocol/>.

use chromiumoxide::browser::BrowserConfig;
use chromiumoxide::cdp::browser_protocol::emulation::{
    MediaFeature, SetDeviceMetricsOverrideParams, SetTouchEmulationEnabledParams,
};
use chromiumoxide::cdp::browser_protocol::input::{
    DispatchKeyEventParams, DispatchMouseEventParams, DispatchTouchEventParams, DispatchTouchEventReturns,
};
use chromiumoxide::cdp::browser_protocol::log::{EventEntryAdded, LogEntryLevel};
use chromiumoxide::cdp::browser_protocol::network::{EventRequestWillBeSent, EventResponseReceived};
use chromiumoxide::cdp::browser_protocol::page::{CaptureScreenshotFormat, NavigateParams};
use chromiumoxide::cdp::js_protocol::runtime::{
    ConsoleApiCalledType, EvaluateParams, EventConsoleApiCalled, EventExceptionThrown,
};
use chromiumoxide::page::ScreenshotParams;
use chromiumoxide::types::MethodId;
use chromiumoxide::{Command, Method, Page};
use futures_util::stream::{self, BoxStream};
use futures_util::{FutureExt, StreamExt};
use serde::Serialize;
use serde::de::DeserializeOwned;
use serde_json::{Value, json};
use std::path::PathBuf;
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::{Duration, Instant};
use tokio::sync::{Mutex, MutexGuard};

/// Message without a browser.
pub const MISSING: &str =
    "no Chromium is on the path, so the page is not tested in a browser; install `chromium`";

/// Timeout of every wait. Only a failure reaches it.
const TIMEOUT: Duration = Duration::from_secs(90);

/// Polling interval of the page.
const POLL_INTERVAL: Duration = Duration::from_millis(50);

/// A browser process with its own profile; killed and cleaned up on drop.
pub struct Browser {
    /// Taken by the drop: its process has to end before its profile is removed.
    browser: Option<chromiumoxide::Browser>,
    profile: PathBuf,
}

impl Browser {
    pub async fn start() -> Self {
        static NUMBER: AtomicU32 = AtomicU32::new(0);
        let number = NUMBER.fetch_add(1, Ordering::Relaxed);
        // A short name: paths of sockets are limited to about a hundred bytes.
        let profile = std::env::temp_dir().join(format!("tombolo-page-{}-{number}", std::process::id()));
        std::fs::create_dir_all(&profile).unwrap();
        let config = BrowserConfig::builder()
            .chrome_executable(installed_browser::chromium().expect(MISSING))
            .new_headless_mode()
            // The sandbox needs privileges that containers lack; only trusted pages are opened.
            .no_sandbox()
            .args(["no-first-run", "disable-gpu"])
            .arg(("force-device-scale-factor", "1"))
            .user_data_dir(&profile)
            .env("TMPDIR", profile.display().to_string())
            .viewport(None)
            .launch_timeout(TIMEOUT)
            .request_timeout(TIMEOUT)
            .build()
            .unwrap();
        let (browser, mut messages) = chromiumoxide::Browser::launch(config).await.unwrap();
        // Sends commands and receives answers until the browser ends.
        tokio::spawn(async move { while messages.next().await.is_some() {} });
        Self { browser: Some(browser), profile }
    }

    /// A new tab, whose errors are recorded from the start.
    pub async fn tab(&self) -> Tab {
        let page = self.browser.as_ref().expect("not dropped").new_page("about:blank").await.unwrap();
        page.enable_log().await.unwrap();
        page.enable_runtime().await.unwrap();
        let recorded = Recorded { entries: entries(&page).await, errors: Vec::new(), requests: Vec::new() };
        Tab { page, recorded: Mutex::new(recorded) }
    }
}

impl Drop for Browser {
    fn drop(&mut self) {
        // Kills the process.
        drop(self.browser.take());
        // Its child processes end slightly later and write to the profile until then.
        for _ in 0..50 {
            if std::fs::remove_dir_all(&self.profile).is_ok() || !self.profile.exists() {
                return;
            }
            std::thread::sleep(Duration::from_millis(20));
        }
    }
}

/// What a page has done.
struct Recorded {
    /// Not yet received.
    entries: BoxStream<'static, Entry>,
    errors: Vec<String>,
    /// URLs of all network requests.
    requests: Vec<String>,
}

enum Entry {
    Error(String),
    Request(String),
    /// The page has logged [`MARKER`].
    Marker,
}

/// Logged by [`Tab::received`].
const MARKER: &str = "all events so far";

impl Recorded {
    /// Returns whether it was the marker.
    fn add(&mut self, entry: Entry) -> bool {
        match entry {
            Entry::Error(error) => self.errors.push(error),
            Entry::Request(url) => self.requests.push(url),
            Entry::Marker => return true,
        }
        false
    }
}

/// Errors and requests of a page.
async fn entries(page: &Page) -> BoxStream<'static, Entry> {
    let exceptions = page.event_listener::<EventExceptionThrown>().await.unwrap();
    let console = page.event_listener::<EventConsoleApiCalled>().await.unwrap();
    let log = page.event_listener::<EventEntryAdded>().await.unwrap();
    let requests = page.event_listener::<EventRequestWillBeSent>().await.unwrap();
    let responses = page.event_listener::<EventResponseReceived>().await.unwrap();
    let exceptions = exceptions.map(|event| Some(Entry::Error(format!("{:?}", event.exception_details))));
    let console = console.map(|event| {
        use ConsoleApiCalledType::{Assert, Debug, Error, Warning};
        match event.r#type {
            Error | Warning | Assert => Some(Entry::Error(format!("{:?}", event.args))),
            Debug => (event.args.first()?.value.as_ref()? == MARKER).then_some(Entry::Marker),
            _ => None,
        }
    });
    let log = log.map(|event| {
        matches!(event.entry.level, LogEntryLevel::Error | LogEntryLevel::Warning)
            .then(|| Entry::Error(format!("{:?}", event.entry)))
    });
    let requests = requests.map(|event| Some(Entry::Request(event.request.url.clone())));
    let responses = responses.map(|event| {
        let (status, url) = (event.response.status, &event.response.url);
        (status >= 400).then(|| Entry::Error(format!("{status} {url}")))
    });
    let all = [exceptions.boxed(), console.boxed(), log.boxed(), requests.boxed(), responses.boxed()];
    stream::select_all(all).filter_map(std::future::ready).boxed()
}

/// `Input.dispatchTouchEvent` without a finger. The type of the library leaves an empty list out,
/// which the browser rejects.
#[derive(Debug, Serialize)]
#[serde(rename_all = "camelCase")]
struct TouchEnd {
    r#type: &'static str,
    touch_points: [(); 0],
}

impl Method for TouchEnd {
    fn identifier(&self) -> MethodId {
        DispatchTouchEventParams::IDENTIFIER.into()
    }
}

impl Command for TouchEnd {
    type Response = DispatchTouchEventReturns;
}

/// One page.
pub struct Tab {
    page: Page,
    recorded: Mutex<Recorded>,
}

impl Tab {
    /// Calls a method with its parameters as JSON and returns its result.
    async fn call<C: Command + DeserializeOwned>(&self, params: Value) -> C::Response {
        let command: C = serde_json::from_value(params).unwrap();
        let method = command.identifier();
        let answer = self.page.execute(command).await;
        answer.unwrap_or_else(|error| panic!("{method}: {error}")).result
    }

    /// Loads a URL, also if only its fragment differs, and waits for the load.
    pub async fn open(&self, url: &str) {
        self.call::<NavigateParams>(json!({ "url": "about:blank" })).await;
        self.wait_for("location.href === 'about:blank'", "an empty page").await;
        let started = self.call::<NavigateParams>(json!({ "url": url })).await;
        assert_eq!(started.error_text, None, "{url}");
        self.wait_for("location.href !== 'about:blank' && document.readyState === 'complete'", url).await;
    }

    /// The value of a script; promises are awaited.
    pub async fn evaluate(&self, script: &str) -> Value {
        let params = json!({ "expression": script, "returnByValue": true, "awaitPromise": true });
        let result = self.call::<EvaluateParams>(params).await;
        assert!(result.exception_details.is_none(), "{script}: {:?}", result.exception_details);
        result.result.value.unwrap_or_default()
    }

    /// Waits until a script returns `true`.
    pub async fn wait_for(&self, script: &str, what: &str) {
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
                let errors = self.take_errors().await;
                panic!(
                    "timed out waiting for {what}; text of the page: {page}; errors: {:?}",
                    &errors[..errors.len().min(3)]
                );
            }
            tokio::time::sleep(POLL_INTERVAL).await;
        }
    }

    /// Errors since the last call.
    pub async fn take_errors(&self) -> Vec<String> {
        std::mem::take(&mut self.received().await.errors)
    }

    /// URLs of all network requests.
    pub async fn requests(&self) -> Vec<String> {
        self.received().await.requests.clone()
    }

    /// Receives the events so far: those before a marker that the page logs now. Each kind has a
    /// queue of its own, in which earlier ones are when the marker is in its own.
    async fn received(&self) -> MutexGuard<'_, Recorded> {
        self.evaluate(&format!("console.debug('{MARKER}')")).await;
        let mut recorded = self.recorded.lock().await;
        let marker = async {
            while let Some(entry) = recorded.entries.next().await {
                if recorded.add(entry) {
                    return;
                }
            }
        };
        tokio::time::timeout(TIMEOUT, marker).await.expect("the browser reports what a page logs");
        while let Some(Some(entry)) = recorded.entries.next().now_or_never() {
            recorded.add(entry);
        }
        recorded
    }

    /// Sets the size of the screen in CSS pixels, and whether it is a phone.
    pub async fn resize(&self, width: u32, height: u32, is_phone: bool) {
        let params = json!({ "width": width, "height": height, "deviceScaleFactor": 1, "mobile": is_phone });
        self.call::<SetDeviceMetricsOverrideParams>(params).await;
    }

    /// Sets a user preference as a CSS media feature.
    pub async fn prefer(&self, feature: &str, value: &str) {
        self.page.emulate_media_features(vec![MediaFeature::new(feature, value)]).await.unwrap();
    }

    /// Drags with the left button in several steps.
    pub async fn drag(&self, from: (f64, f64), to: (f64, f64)) {
        self.mouse("mousePressed", from, json!({ "button": "left", "buttons": 1, "clickCount": 1 })).await;
        for step in 1..=4 {
            let share = f64::from(step) / 4.0;
            let place = (from.0 + (to.0 - from.0) * share, from.1 + (to.1 - from.1) * share);
            self.mouse("mouseMoved", place, json!({ "button": "left", "buttons": 1 })).await;
        }
        self.mouse("mouseReleased", to, json!({ "button": "left", "clickCount": 1 })).await;
    }

    /// Turns the wheel at a position; negative is away from the user.
    pub async fn wheel(&self, at: (f64, f64), units: f64) {
        self.mouse("mouseWheel", at, json!({ "deltaX": 0, "deltaY": units })).await;
    }

    /// Touches with two fingers at a distance around a position, and moves them apart or together.
    pub async fn pinch(&self, (x, y): (f64, f64), from: f64, to: f64) {
        let enabled = json!({ "enabled": true, "maxTouchPoints": 2 });
        self.call::<SetTouchEmulationEnabledParams>(enabled).await;
        let fingers =
            |away: f64| json!([{ "x": x - away, "y": y, "id": 1 }, { "x": x + away, "y": y, "id": 2 }]);
        self.touch("touchStart", fingers(from)).await;
        for step in 1..=4 {
            self.touch("touchMove", fingers(from + (to - from) * f64::from(step) / 4.0)).await;
        }
        self.page.execute(TouchEnd { r#type: "touchEnd", touch_points: [] }).await.unwrap();
    }

    async fn touch(&self, kind: &str, points: Value) {
        self.call::<DispatchTouchEventParams>(json!({ "type": kind, "touchPoints": points })).await;
    }

    async fn mouse(&self, kind: &str, (x, y): (f64, f64), more: Value) {
        let mut params = json!({ "type": kind, "x": x, "y": y });
        for (name, value) in more.as_object().unwrap() {
            params[name] = value.clone();
        }
        self.call::<DispatchMouseEventParams>(params).await;
    }

    /// Presses and releases a key.
    pub async fn key(&self, key: &str) {
        for kind in ["rawKeyDown", "keyUp"] {
            self.call::<DispatchKeyEventParams>(json!({ "type": kind, "key": key })).await;
        }
    }

    /// A screenshot as PNG.
    pub async fn screenshot(&self) -> Vec<u8> {
        let format = ScreenshotParams::builder().format(CaptureScreenshotFormat::Png).build();
        self.page.screenshot(format).await.unwrap()
    }
}
