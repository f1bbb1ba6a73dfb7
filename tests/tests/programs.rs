//! The built binaries: options, exit codes, and one-line messages.

use std::time::{Duration, Instant};
use tests::program::{ServerProgram, command, errors, run};

const PROGRAMS: [&str; 3] = ["tombolo-server", "tombolo-view", "tombolo-load"];

/// Asserts that a program ends with the code and one line on standard error with every word.
fn refused(name: &str, arguments: &[&str], code: i32, words: &[&str]) {
    let output = run(name, arguments);
    let line = errors(&output);
    assert_eq!(output.status.code(), Some(code), "{name} {arguments:?}: {line}");
    assert_eq!(line.lines().count(), 1, "{name} {arguments:?}: {line}");
    for word in words {
        assert!(line.contains(word), "{name} {arguments:?}: `{line}` lacks `{word}`");
    }
}

#[test]
fn every_program_has_help_and_a_version() {
    for name in PROGRAMS {
        let help = run(name, &["--help"]);
        let text = String::from_utf8(help.stdout).unwrap();
        assert!(
            help.status.success() && text.contains("Usage") && text.contains("default"),
            "{name}: {text}"
        );
        let version = run(name, &["--version"]);
        assert!(version.status.success());
        assert!(String::from_utf8(version.stdout).unwrap().starts_with(name));
    }
}

#[test]
fn an_unknown_option_is_named_with_exit_code_2() {
    for name in PROGRAMS {
        refused(name, &["--no-such-option", "5"], 2, &["--no-such-option"]);
    }
}

#[test]
fn values_out_of_range_are_named_with_their_range() {
    refused("tombolo-server", &["--threads", "0"], 2, &["threads", "0", "1 to 1024"]);
    refused("tombolo-server", &["--world-seed", "minus"], 2, &["--world-seed", "minus"]);
    refused("tombolo-server", &["--listen", "nowhere"], 2, &["listen", "nowhere", "ADDR:PORT"]);
    refused("tombolo-server", &["--log", "loud=?"], 2, &["log", "loud=?"]);
    refused("tombolo-view", &["--scene", "moon"], 2, &["--scene", "moon", "island"]);
    refused("tombolo-view", &["--camera", "1,2,3"], 2, &["--camera", "1,2,3"]);
    refused("tombolo-view", &["--camera", "NaN,0,0,0,0"], 2, &["--camera"]);
    refused("tombolo-view", &["--camera", "99999999,0,0,0,0"], 2, &["--camera", "99999999"]);
    refused(
        "tombolo-view",
        &["--delivery", "lossy"],
        2,
        &["--delivery", "lossy", "exact, refined, seed or quantised:METRES"],
    );
    refused("tombolo-view", &["--digest", "abc"], 2, &["--digest", "abc", "64 hexadecimal digits"]);
    refused(
        "tombolo-load",
        &["--delivery", "lossy"],
        2,
        &["--delivery", "lossy", "exact, refined, seed or quantised:METRES"],
    );
    refused("tombolo-view", &["--size", "0x0"], 2, &["--size", "0x0"]);
    refused("tombolo-view", &["--tolerance", "-1"], 2, &["--tolerance", "-1", "0.0625 to 1000"]);
    refused("tombolo-view", &["--chunk-mb", "-1"], 2, &["--chunk-mb", "-1"]);
    refused("tombolo-load", &["--clients", "none"], 2, &["--clients", "none"]);
    refused("tombolo-load", &["--connect", "not a url"], 2, &["--connect"]);
}

#[test]
fn a_malformed_configuration_file_is_refused_by_line() {
    let path = std::env::temp_dir().join(format!("tombolo-programs-{}.toml", std::process::id()));
    std::fs::write(&path, "threads = 2\nlisten = 7\n").unwrap();
    let text = path.to_str().unwrap();
    refused("tombolo-server", &["--config", text], 2, &["config", text, "line 2"]);
    std::fs::remove_file(path).unwrap();
}

#[test]
fn a_port_in_use_is_named_with_what_to_do() {
    let server = ServerProgram::start(&[]);
    refused("tombolo-server", &["--listen", &server.address], 1, &[&server.address, "--listen"]);
}

#[test]
fn an_unreachable_server_is_named() {
    let nowhere = "ws://127.0.0.1:9/v1/stream";
    refused("tombolo-load", &["--connect", nowhere, "--clients", "1", "--seconds", "1"], 1, &[nowhere]);
    let picture = std::env::temp_dir().join("tombolo-never.png");
    let picture = picture.to_str().unwrap();
    refused(
        "tombolo-view",
        &["--connect", nowhere, "--shot", picture, "--size", "64x64"],
        1,
        &["127.0.0.1:9"],
    );
}

#[test]
fn an_unwritable_picture_is_reported_before_connecting() {
    let nowhere = ["--connect", "ws://127.0.0.1:9/v1/stream", "--shot"];
    let with = |more: &[&'static str]| [nowhere.as_slice(), more].concat();
    refused("tombolo-view", &with(&["/no/such/folder/a.png"]), 2, &["--shot", "/no/such/folder", "create"]);
    refused("tombolo-view", &with(&["a.jpg"]), 2, &["--shot a.jpg", ".png"]);
    refused("tombolo-view", &with(&["a.png", "--stats", "/no/such/a.json"]), 2, &["--stats /no/such"]);
}

#[test]
fn without_a_gpu_the_viewer_names_a_driver_package() {
    let output = command("tombolo-view")
        .args(["--shot", "never.png", "--size", "64x64"])
        .env("VK_DRIVER_FILES", "/dev/null")
        .env("VK_ICD_FILENAMES", "/dev/null")
        .env("LIBGL_DRIVERS_PATH", "/dev/null")
        .env("__EGL_VENDOR_LIBRARY_FILENAMES", "/dev/null")
        .output()
        .unwrap();
    let line = errors(&output);
    assert_eq!(output.status.code(), Some(1), "{line}");
    assert!(line.lines().count() == 1 && line.contains("mesa-vulkan-drivers"), "{line}");
}

#[test]
fn without_a_display_the_viewer_names_the_shot_option() {
    let output =
        command("tombolo-view").env_remove("DISPLAY").env_remove("WAYLAND_DISPLAY").output().unwrap();
    let line = errors(&output);
    assert_eq!(output.status.code(), Some(1), "{line}");
    assert!(line.lines().count() == 1 && line.contains("--shot"), "{line}");
}

#[test]
fn a_terminated_server_drains_and_exits_with_0() {
    let mut server = ServerProgram::start(&[]);
    server.signal("TERM");
    let started = Instant::now();
    let status = loop {
        if let Some(status) = server.child.try_wait().unwrap() {
            break status;
        }
        assert!(started.elapsed() < Duration::from_secs(30), "the server does not end");
        std::thread::sleep(Duration::from_millis(20));
    };
    assert!(status.success(), "{status}");
}

#[test]
fn a_short_load_test_verifies_chunks_and_writes_its_record() {
    let server = ServerProgram::start(&[]);
    let record = std::env::temp_dir().join(format!("tombolo-load-{}.json", std::process::id()));
    let run_with = |delivery: &[&str]| {
        let url = server.stream_url();
        let path = record.to_str().unwrap();
        let arguments = ["--clients", "3", "--seconds", "3", "--connect", &url, "--json", path];
        let output = run("tombolo-load", &[&arguments, delivery].concat());
        assert!(output.status.success(), "{}", errors(&output));
        let json: serde_json::Value = serde_json::from_slice(&std::fs::read(&record).unwrap()).unwrap();
        std::fs::remove_file(&record).unwrap();
        json
    };
    let seed = run_with(&["--delivery", "seed"]);
    let count = |name: &str| seed[name].as_u64().unwrap();
    assert_eq!((&seed["delivery"], count("mismatches"), count("dropped")), (&"seed".into(), 0, 0));
    assert!(count("chunks") > 0 && count("regenerated") == count("chunks"), "{seed}");
    assert_eq!(count("bytes"), count("chunks") * 36, "{seed}");

    let json = run_with(&[]);
    assert_eq!(json["delivery"], "exact");
    assert_eq!(
        (json["clients"].as_u64(), json["mismatches"].as_u64(), json["dropped"].as_u64()),
        (Some(3), Some(0), Some(0))
    );
    assert!(json["chunks"].as_u64() > Some(0) && json["bytes"].as_u64() > Some(0), "{json}");
    for quantile in ["p50", "p99", "p999"] {
        assert!(json["latency_ms"][quantile].is_number(), "{json}");
    }
    assert!(json["seconds"].is_number() && json["refused"].is_number());
}

#[test]
fn a_shot_writes_a_picture_and_all_statistics() {
    let server = ServerProgram::start(&[]);
    let base = std::env::temp_dir().join(format!("tombolo-shot-{}", std::process::id()));
    let (picture, stats) = (base.with_extension("png"), base.with_extension("json"));
    let output = run(
        "tombolo-view",
        &[
            "--connect",
            &server.stream_url(),
            "--shot",
            picture.to_str().unwrap(),
            "--stats",
            stats.to_str().unwrap(),
            "--size",
            "96x54",
            "--frames",
            "2",
            "--view-distance",
            "1500",
        ],
    );
    if errors(&output).contains("mesa-vulkan-drivers") && !tests::gpu_is_required() {
        eprintln!("SKIPPED: no GPU adapter");
        return;
    }
    assert!(output.status.success(), "{}", errors(&output));
    assert_eq!(image::image_dimensions(&picture).unwrap(), (96, 54));
    let json: serde_json::Value = serde_json::from_slice(&std::fs::read(&stats).unwrap()).unwrap();
    for number in [
        "frames",
        "chunks_drawn",
        "triangles",
        "bytes_received",
        "seconds_to_first_chunk",
        "seconds_to_complete_view",
        "frame_ms_p50",
        "frame_ms_p99",
    ] {
        assert!(json[number].as_f64() > Some(0.0), "{number}: {json}");
    }
    assert_eq!(json["delivery"], "exact");
    assert!(json["adapter"].as_str().is_some_and(|name| !name.is_empty()));
    std::fs::remove_file(picture).unwrap();
    std::fs::remove_file(stats).unwrap();
}
