//! The page in a real browser: headless Chromium, driven over its debugging protocol, against the
//! real `tombolo-server`.
//!
//! | module | job |
//! | --- | --- |
//! | `chromium` | the browser process and the DevTools protocol |
//! | `programs` | the server process, and moving clients |
//!
//! Without an installed browser the tests are listed as ignored, not as passed, with the reason.
//! With `TOMBOLO_REQUIRE_BROWSER` they fail instead. `TOMBOLO_SCREENSHOTS` is a folder for the
//! screenshots.

mod chromium;
mod programs;

use chromium::{Browser, Tab};
use libtest_mimic::{Arguments, Failed, Trial};
use programs::{MovingClient, Program};
use serde_json::{Value, json};
use std::path::{Path, PathBuf};
use std::process::ExitCode;

fn main() -> ExitCode {
    let arguments = Arguments::from_args();
    let is_missing = installed_browser::chromium().is_none();
    let is_required = std::env::var_os("TOMBOLO_REQUIRE_BROWSER").is_some();
    if is_missing {
        eprintln!("NOT TESTED: {}", chromium::MISSING);
    }
    let trial = |name: &str, test: fn(&tokio::runtime::Runtime) -> Result<(), Failed>| {
        let run = move || {
            if installed_browser::chromium().is_none() {
                return Err(chromium::MISSING.into());
            }
            test(&tokio::runtime::Builder::new_multi_thread().worker_threads(2).enable_all().build()?)
        };
        Trial::test(name, run).with_ignored_flag(is_missing && !is_required)
    };
    let trials = vec![
        trial("the_page_shows_map_clients_and_load_and_can_be_navigated", |runtime| {
            runtime.block_on(visit());
            Ok(())
        }),
        trial("an_outage_is_shown_and_the_page_reconnects", |runtime| {
            runtime.block_on(outage());
            Ok(())
        }),
        trial("a_server_with_a_token_requires_it", |runtime| {
            runtime.block_on(token());
            Ok(())
        }),
    ];
    libtest_mimic::run(&arguments, trials).exit_code()
}

/// All visible tiles are drawn, and there are some.
const PAINTED: &str = "(({ wanted, drawn }) => Number(wanted) > 3 && wanted === drawn)\
    (document.getElementById('relief').dataset)";

/// Text of an element.
async fn text(tab: &Tab, id: &str) -> String {
    let value = tab.evaluate(&format!("document.getElementById('{id}').textContent")).await;
    value.as_str().unwrap().to_owned()
}

/// Position of a session's arrow, CSS pixels.
async fn arrow(tab: &Tab, session: u64) -> (f64, f64) {
    let script = format!(
        "[...document.querySelectorAll('.client')]
            .find((group) => group.querySelector('text').textContent === '{session}')
            .getAttribute('transform').match(/-?[\\d.]+/g).map(Number)"
    );
    let place = tab.evaluate(&script).await;
    (place[0].as_f64().unwrap(), place[1].as_f64().unwrap())
}

/// Number of colours in a grid of points of the canvas, and of those that are blue.
async fn colours(tab: &Tab) -> (u64, u64) {
    let script = "(() => {
        const canvas = document.getElementById('relief');
        const { width, height } = canvas;
        const copy = new OffscreenCanvas(width, height).getContext('2d', { willReadFrequently: true });
        copy.drawImage(canvas, 0, 0);
        const { data } = copy.getImageData(0, 0, width, height);
        const seen = new Set();
        let blue = 0;
        for (let x = 8; x < width; x += 16) for (let y = 8; y < height; y += 16) {
            const [r, g, b] = data.subarray(4 * (y * width + x));
            seen.add((r << 16) | (g << 8) | b);
            if (b > r + 30) blue += 1;
        }
        return [seen.size, blue];
    })()";
    let counts = tab.evaluate(script).await;
    (counts[0].as_u64().unwrap(), counts[1].as_u64().unwrap())
}

async fn visit() {
    let server = Program::start("127.0.0.1:0", &[]);
    let still = MovingClient::start(&server, [-2600, 1400], 45_000, 0).await;
    let others = [
        MovingClient::start(&server, [-300, -900], 200_000, 90).await,
        MovingClient::start(&server, [1900, 2300], -60_000, 120).await,
        MovingClient::start(&server, [1500, -2700], 120_000, 60).await,
    ];
    let browser = Browser::start().await;
    let tab = browser.tab().await;
    tab.resize(1280, 800, false).await;
    tab.open(&server.page()).await;

    // The initial state.
    tab.wait_for(PAINTED, "all tiles").await;
    tab.wait_for("document.body.dataset.state === 'live'", "the server's figures").await;
    tab.wait_for("document.getElementById('clients').dataset.shown === '4'", "an arrow for every client")
        .await;
    tab.wait_for("Number(document.getElementById('clients-open').value) === 4", "the number of clients")
        .await;
    tab.wait_for("parseFloat(document.getElementById('chunks').value) > 0", "chunks that flow").await;
    tab.wait_for("parseFloat(document.getElementById('bytes').value) > 0", "bytes that flow").await;
    tab.wait_for("parseFloat(document.getElementById('latency').value) > 0", "a latency").await;
    tab.wait_for("document.querySelectorAll('#list li').length === 4", "a list of clients").await;
    tab.wait_for(
        "/ (high|deep)$/.test(document.getElementById('place').textContent)",
        "the height of the middle",
    )
    .await;
    let (colours_seen, blue) = colours(&tab).await;
    assert!(colours_seen > 200 && blue > 300, "{colours_seen} colours, {blue} blue points");
    let command = text(&tab, "command").await;
    assert_eq!(command, format!("tombolo-view --connect {}", server.stream()));
    let scale = text(&tab, "scale-text").await;
    assert_eq!(scale, "2 km");

    // Dragging moves map and clients equally.
    let before = arrow(&tab, still.session).await;
    tab.drag((600.0, 500.0), (480.0, 440.0)).await;
    tab.wait_for(PAINTED, "all tiles after a drag").await;
    let after = arrow(&tab, still.session).await;
    let moved = (after.0 - before.0, after.1 - before.1);
    assert!((moved.0 + 120.0).abs() < 1.0 && (moved.1 + 60.0).abs() < 1.0, "{moved:?}");

    // The wheel zooms around the pointer.
    let level =
        tab.evaluate("Number(document.getElementById('relief').dataset.level)").await.as_i64().unwrap();
    tab.wheel(after, -480.0).await;
    tab.wait_for(
        &format!("Number(document.getElementById('relief').dataset.level) < {level}"),
        "a finer level",
    )
    .await;
    tab.wait_for(PAINTED, "all tiles after zooming").await;
    let zoomed = arrow(&tab, still.session).await;
    assert!((zoomed.0 - after.0).abs() < 1.0 && (zoomed.1 - after.1).abs() < 1.0, "{after:?} {zoomed:?}");

    // Keys.
    tab.evaluate("document.getElementById('map').focus()").await;
    tab.key("ArrowRight").await;
    tab.wait_for("true", "a frame").await;
    let script = "document.querySelector('.client text') && location.hash.length > 5";
    tab.wait_for(script, "a place in the address").await;
    tab.wait_for(
        &format!("{} < {}", ARROW_X.replace("SESSION", &still.session.to_string()), zoomed.0 - 50.0),
        "a step to the east",
    )
    .await;
    tab.key("0").await;
    let home =
        format!("Math.abs({} - {}) < 1", ARROW_X.replace("SESSION", &still.session.to_string()), before.0);
    tab.wait_for(&home, "home by key").await;

    // The URL contains the view.
    tab.open(&format!("{}#x=2000&z=-1500&level=2.50", server.page())).await;
    tab.wait_for(PAINTED, "all tiles of a shared place").await;
    assert_eq!(tab.evaluate("document.getElementById('relief').dataset.level").await, "2");
    tab.wait_for(
        "document.getElementById('scale-text').textContent === '200 m'",
        "the scale of a shared place",
    )
    .await;
    tab.wait_for(
        "document.getElementById('place').textContent.startsWith('2,000 m E, 1,500 m N')",
        "the place itself",
    )
    .await;
    // By button, and to a client's position.
    tab.evaluate("document.getElementById('closer').click()").await;
    tab.wait_for("document.getElementById('relief').dataset.level === '1'", "the button that zooms in").await;
    tab.wait_for("document.querySelectorAll('#list li').length === 4", "the list again").await;
    tab.evaluate("document.querySelector('#list button').click()").await;
    tab.wait_for(
        "document.getElementById('place').textContent.startsWith('2,600 m W, 1,400 m S')",
        "a client, by the list",
    )
    .await;

    // With reduced motion an animation ends at once; the control is without.
    let jumps = "(() => {
        const text = () => document.getElementById('scale-text').textContent;
        const width = () => document.getElementById('scale-bar').style.width + text();
        const before = width();
        document.getElementById('farther').click();
        return width() !== before;
    })()";
    assert_eq!(tab.evaluate(jumps).await, false);
    tab.prefer("prefers-reduced-motion", "reduce").await;
    assert_eq!(tab.evaluate(jumps).await, true);
    tab.prefer("prefers-reduced-motion", "no-preference").await;

    // No errors, and all requests went to this server.
    let faults = tab.take_errors().await;
    assert_eq!(faults, Vec::<String>::new());
    let requests = tab.requests().await;
    assert!(
        requests.len() > 50 && requests.iter().all(|url| url.starts_with(&server.page())),
        "{requests:?}"
    );
    // The controls: an error is detected, and the policy blocks other servers.
    tab.evaluate("console.error('a control')").await;
    tab.wait_for("true", "a moment").await;
    assert!(tab.take_errors().await.iter().any(|fault| fault.contains("a control")));
    let foreign = "new Promise((done) => {
        addEventListener('securitypolicyviolation',
            (event) => done(event.effectiveDirective), { once: true });
        new Image().src = 'http://127.0.0.1:9/picture.png';
    })";
    assert_eq!(tab.evaluate(foreign).await, "img-src");
    assert!(!tab.take_errors().await.is_empty(), "which the browser reports as an error");

    // Screenshots for inspection.
    for (name, width, height, scheme, fragment) in [
        ("wide", 1280, 800, "light", ""),
        ("wide-dark", 1280, 800, "dark", ""),
        ("low", 1000, 625, "light", ""),
        ("narrow", 390, 844, "light", ""),
        ("near", 1280, 800, "light", "#x=-1900&z=900&level=1.60"),
        ("far", 1280, 800, "light", "#x=3000&z=-1500&level=8.60"),
    ] {
        tab.resize(width, height, width < 640).await;
        tab.prefer("prefers-color-scheme", scheme).await;
        tab.open(&format!("{}{fragment}", server.page())).await;
        tab.wait_for(PAINTED, "all tiles of a picture").await;
        tab.wait_for("document.querySelectorAll('#list li').length === 4", "the list of a picture").await;
        // A sparkline needs several values.
        let points = if folder().is_some() { 20 } else { 3 };
        let curve = format!(
            "(document.querySelector('#spark-chunks .curve').getAttribute('d') ?? '')\
             .split('L').length > {points}"
        );
        tab.wait_for(&curve, "a curve").await;
        let overflows = tab
            .evaluate(
                "document.documentElement.scrollWidth > innerWidth \
             || document.documentElement.scrollHeight > innerHeight",
            )
            .await;
        assert_eq!(overflows, false, "{name} fits its screen");
        save_screenshot(&tab, name, width, height).await;
    }

    // On a phone details are behind a button, and two fingers zoom.
    tab.resize(390, 844, true).await;
    tab.open(&server.page()).await;
    tab.wait_for(PAINTED, "all tiles on a phone").await;
    assert_eq!(tab.evaluate("document.getElementById('details').checkVisibility()").await, false);
    tab.evaluate("document.getElementById('more').click()").await;
    tab.wait_for("document.getElementById('details').checkVisibility()", "the rest").await;
    assert_eq!(tab.evaluate("document.getElementById('more').getAttribute('aria-expanded')").await, "true");
    tab.wait_for("document.querySelectorAll('#list li').length === 4", "the list on a phone").await;
    save_screenshot(&tab, "narrow-open", 390, 844).await;
    tab.evaluate("document.getElementById('more').click()").await;
    let level =
        tab.evaluate("Number(document.getElementById('relief').dataset.level)").await.as_i64().unwrap();
    tab.pinch((195.0, 400.0), 30.0, 150.0).await;
    let finer = format!("Number(document.getElementById('relief').dataset.level) === {level} - 2");
    tab.wait_for(&finer, "two levels finer at five times the distance of two fingers").await;
    assert_eq!(tab.take_errors().await, Vec::<String>::new());
    drop((still, others));
}

/// Takes a screenshot, checks its size, and saves it if requested.
async fn save_screenshot(tab: &Tab, name: &str, width: u32, height: u32) {
    assert_eq!(tab.evaluate(OVERLAPS).await, json!([]), "{name}");
    let picture = tab.screenshot().await;
    let mut decoded = png::Decoder::new(std::io::Cursor::new(&picture)).read_info().unwrap();
    assert_eq!((decoded.info().width, decoded.info().height), (width, height), "{name}");
    let mut pixels = vec![0; decoded.output_buffer_size().unwrap()];
    decoded.next_frame(&mut pixels).unwrap();
    if let Some(folder) = folder() {
        std::fs::write(folder.join(format!("page-{name}.png")), &picture).unwrap();
    }
}

/// Overlapping cards.
const OVERLAPS: &str = "(() => {
    const box = (id) => document.getElementById(id).getBoundingClientRect();
    const cards = ['title', 'panel', 'controls', 'legend'].map((id) => [id, box(id)]);
    return cards.flatMap(([a, first], index) => cards.slice(index + 1)
        .filter(([, second]) => first.left < second.right && second.left < first.right
            && first.top < second.bottom && second.top < first.bottom)
        .map(([b]) => `${a} and ${b}`));
})()";

/// East coordinate of the arrow of SESSION.
const ARROW_X: &str = "Number([...document.querySelectorAll('.client')]\
    .find((group) => group.querySelector('text').textContent === 'SESSION')\
    .getAttribute('transform').match(/-?[\\d.]+/)[0])";

/// Folder for screenshots, if any.
fn folder() -> Option<PathBuf> {
    std::env::var_os("TOMBOLO_SCREENSHOTS").map(|folder| Path::new(&folder).to_owned())
}

async fn outage() {
    let server = Program::start("127.0.0.1:0", &[]);
    let (page, address) = (server.page(), server.address.clone());
    let browser = Browser::start().await;
    let tab = browser.tab().await;
    tab.resize(390, 844, true).await;
    tab.open(&page).await;
    tab.wait_for("document.body.dataset.state === 'live'", "the server's figures").await;
    tab.wait_for(PAINTED, "all tiles").await;
    assert_eq!(tab.evaluate("document.getElementById('notice').hidden").await, true);
    drop(server);
    tab.wait_for(
        "document.body.dataset.state === 'away' && !document.getElementById('notice').hidden",
        "word of the outage",
    )
    .await;
    assert!(text(&tab, "notice").await.contains("does not answer"));
    // A place without cached tiles: without a server there are none.
    tab.evaluate("location.hash = '#x=30000&z=9000&level=4.00'").await;
    tab.wait_for("Number(document.getElementById('relief').dataset.drawn) === 0", "nothing to draw").await;
    let _back = Program::start(&address, &[]);
    tab.wait_for(
        "document.body.dataset.state === 'live' && document.getElementById('notice').hidden",
        "the server again",
    )
    .await;
    tab.wait_for(PAINTED, "all tiles after the outage").await;
}

async fn token() {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR"));
    let file = folder.join(format!("token-{}", std::process::id()));
    std::fs::write(&file, "sesame\n").unwrap();
    let server = Program::start("127.0.0.1:0", &["--token-file", file.to_str().unwrap()]);
    let browser = Browser::start().await;
    let tab = browser.tab().await;
    tab.resize(1280, 800, false).await;
    tab.open(&server.page()).await;
    tab.wait_for(
        "document.body.dataset.state === 'locked' && !document.getElementById('token').hidden",
        "the question",
    )
    .await;
    let enter = |token: &str| {
        format!(
            "document.getElementById('token-text').value = {}; \
             document.querySelector('#token button').click()",
            json!(token)
        )
    };
    tab.evaluate(&enter("wrong")).await;
    tab.wait_for(
        "document.body.dataset.state === 'locked' && !document.getElementById('token').hidden",
        "the question again",
    )
    .await;
    assert_eq!(tab.evaluate("document.getElementById('relief').dataset.drawn").await, Value::from("0"));
    tab.evaluate(&enter("sesame")).await;
    tab.wait_for(
        "document.body.dataset.state === 'live' && document.getElementById('token').hidden",
        "the figures",
    )
    .await;
    tab.wait_for(PAINTED, "all tiles").await;
    std::fs::remove_file(file).unwrap();
}
