//! The program as a script uses it: exit codes and one-line messages.

use std::process::{Command, Output, Stdio};

fn run(args: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_tombolo-load")).args(args).output().expect("the program starts")
}

fn message(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

#[test]
fn invalid_options_end_with_2_and_one_line() {
    for (args, word) in [
        (&["--colour", "red"][..], "--colour"),
        (&["--clients", "0"], "--clients"),
        (&["--bench", "idle", "--rounds", "0"], "tombolo-server-bench idle --rounds 0"),
        (&["--rate", "0"], "--rate"),
        (&["--plot", "plot.jpg"], "plot.jpg"),
        (&["--mode", "http", "--delivery", "seed"], "--delivery"),
        (&["--connect", "http://127.0.0.1/"], "--connect"),
        (&["--token-file", "/no/such/file"], "/no/such/file"),
        (&["--ca-file", "ca.pem"], "--ca-file: a ws:// address has no TLS"),
    ] {
        let output = run(args);
        let text = message(&output);
        assert_eq!(output.status.code(), Some(2), "{text}");
        assert!(text.starts_with("tombolo-load: ") && text.contains(word), "{text}");
        assert_eq!(text.lines().count(), 1, "{text}");
    }
}

#[test]
fn no_server_ends_with_1_a_report_and_one_line() {
    let listener = std::net::TcpListener::bind("127.0.0.1:0").expect("a free port");
    let address = listener.local_addr().expect("bound").to_string();
    drop(listener);
    let url = format!("ws://{address}/v1/stream");
    let json = std::env::temp_dir().join(format!("tombolo-load-options-{}.json", std::process::id()));
    let path = json.to_str().expect("a plain path");
    let picture = json.with_extension("png");
    let plot = picture.to_str().expect("a plain path");
    let output =
        run(&["--connect", &url, "--clients", "2", "--seconds", "1", "--json", path, "--plot", plot]);
    let is_picture = std::fs::read(&picture).expect("the plot is written too").starts_with(b"\x89PNG");
    let _ = std::fs::remove_file(&picture);
    assert!(is_picture);
    let report = std::fs::read_to_string(&json).expect("a failed run has a report too");
    let _ = std::fs::remove_file(&json);
    let text = message(&output);
    assert_eq!(output.status.code(), Some(1), "{text}");
    assert!(text.contains("no chunk arrived") && text.contains(&address), "{text}");
    assert_eq!(text.lines().count(), 1, "{text}");
    assert!(report.contains("\"chunks\": 0"), "{report}");
}

#[test]
fn an_unwritable_report_fails_before_the_run() {
    let output = run(&["--json", "/no/such/folder/report.json", "--seconds", "3600"]);
    assert_eq!(output.status.code(), Some(1));
    assert!(message(&output).contains("/no/such/folder/report.json"), "{}", message(&output));
    let output = run(&["--plot", "/no/such/folder/plot.png", "--seconds", "3600"]);
    assert!(
        message(&output).contains("--plot: cannot write `/no/such/folder/plot.png`"),
        "{}",
        message(&output)
    );
}

#[test]
fn an_old_report_stays_until_there_is_a_new_one() {
    let json = std::env::temp_dir().join(format!("tombolo-load-old-{}.json", std::process::id()));
    std::fs::write(&json, "old").expect("a temporary file");
    let output = run(&["--json", json.to_str().expect("a plain path"), "--plot", "/no/such/folder/plot.png"]);
    let kept = std::fs::read_to_string(&json).expect("still there");
    let _ = std::fs::remove_file(&json);
    assert_eq!((output.status.code(), kept.as_str()), (Some(1), "old"));
}

#[test]
fn a_report_whose_folder_is_gone_is_an_error_beside_the_verdict() {
    let listener = std::net::TcpListener::bind("127.0.0.1:0").expect("a free port");
    let url = format!("ws://{}/v1/stream", listener.local_addr().expect("bound"));
    drop(listener);
    let folder = std::env::temp_dir().join(format!("tombolo-load-gone-{}", std::process::id()));
    std::fs::create_dir_all(&folder).expect("a temporary folder");
    let json = folder.join("report.json");
    let program = Command::new(env!("CARGO_BIN_EXE_tombolo-load"))
        .args(["--connect", &url, "--clients", "1", "--seconds", "3", "--json"])
        .arg(&json)
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .expect("the program starts");
    // Both are made before the run begins.
    while !json.exists() {
        std::thread::sleep(std::time::Duration::from_millis(5));
    }
    std::fs::remove_dir_all(&folder).expect("removed during the run");
    let output = program.wait_with_output().expect("the program ends");
    let text = message(&output);
    assert_eq!(output.status.code(), Some(1), "{text}");
    assert!(text.contains("--json: cannot write") && text.contains("no chunk arrived"), "{text}");
    assert_eq!(text.lines().count(), 1, "{text}");
    assert!(String::from_utf8_lossy(&output.stdout).contains("clients"), "the table is printed");
}

#[cfg(unix)]
#[test]
fn an_interrupt_ends_with_130_and_the_report_so_far() {
    let listener = std::net::TcpListener::bind("127.0.0.1:0").expect("a free port");
    let url = format!("ws://{}/v1/stream", listener.local_addr().expect("bound"));
    let json = std::env::temp_dir().join(format!("tombolo-load-interrupt-{}.json", std::process::id()));
    let mut program = Command::new(env!("CARGO_BIN_EXE_tombolo-load"))
        .args(["--connect", &url, "--clients", "1", "--seconds", "3600", "--json"])
        .arg(&json)
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .expect("the program starts");
    // The program handles signals before its first client connects. The client gets no answer.
    listener.set_nonblocking(true).expect("a listener");
    let connection = loop {
        match listener.accept() {
            Ok(connection) => break connection,
            Err(_) if program.try_wait().expect("a child").is_none() => {
                std::thread::sleep(std::time::Duration::from_millis(5));
            }
            Err(error) => panic!("the program ended before it connected: {error}"),
        }
    };
    let killed = Command::new("kill").args(["-INT", &program.id().to_string()]).status();
    assert!(killed.expect("kill runs").success());
    let output = program.wait_with_output().expect("the program ends");
    drop(connection);
    let report = std::fs::read_to_string(&json).expect("the report so far");
    let _ = std::fs::remove_file(&json);
    let text = message(&output);
    assert_eq!(output.status.code(), Some(130), "{text}");
    assert!(text.starts_with("tombolo-load: interrupted after ") && text.lines().count() == 1, "{text}");
    assert!(report.contains("\"interrupted\": true") && report.contains("\"chunks\": 0"), "{report}");
    assert!(String::from_utf8_lossy(&output.stdout).contains("interrupted"), "the table is printed");
}

#[test]
fn help_has_units_and_defaults_and_ends_with_0() {
    let output = run(&["--help"]);
    let text = String::from_utf8_lossy(&output.stdout).into_owned();
    assert_eq!(output.status.code(), Some(0));
    for part in [
        "seconds",
        "metres",
        "0 to 4294967295",
        "[default: 2000]",
        "1.4 m/s",
        "conditionally",
        "ws://127.0.0.1:7580/v1/stream",
    ] {
        assert!(text.contains(part), "{part} is not in:\n{text}");
    }
    assert_eq!(run(&["--version"]).status.code(), Some(0));
}
