//! The program as a script uses it: exit codes and one-line messages.

use std::process::{Command, Output};

fn run(args: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_tombolo-server-bench")).args(args).output().expect("the program starts")
}

fn message(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

#[test]
fn invalid_options_end_with_2_and_one_line() {
    for (args, word) in [
        (&["swim"][..], "swim"),
        (&["idle", "--rounds", "0"], "--rounds"),
        (&["idle", "--colour", "red"], "--colour"),
    ] {
        let output = run(args);
        let text = message(&output);
        assert_eq!(output.status.code(), Some(2), "{text}");
        assert!(text.starts_with("tombolo-server-bench: ") && text.contains(word), "{text}");
        assert_eq!(text.lines().count(), 1, "{text}");
    }
}

#[test]
fn a_missing_server_program_ends_with_1_and_one_line() {
    let output = run(&["idle", "--server", "/no/such/server"]);
    let text = message(&output);
    assert_eq!(output.status.code(), Some(1), "{text}");
    assert!(text.contains("/no/such/server") && text.contains("--server"), "{text}");
    assert_eq!(text.lines().count(), 1, "{text}");
}

#[test]
fn an_unwritable_report_fails_before_the_run() {
    let output = run(&["idle", "--server", "/no/such/server", "--json", "/no/such/folder/report.json"]);
    assert_eq!(output.status.code(), Some(1));
    assert!(message(&output).contains("--json: cannot write `/no/such/folder/report.json`"));
}
