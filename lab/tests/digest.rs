//! The built program: its table, its JSON, its exit code.

use std::path::PathBuf;
use std::process::Command;

/// A file that is removed when dropped.
struct Scratch(PathBuf);

impl Drop for Scratch {
    fn drop(&mut self) {
        // It may never have been written.
        let _ = std::fs::remove_file(&self.0);
    }
}

#[test]
fn every_backend_has_the_frozen_digest_and_the_control_differs() {
    let file = Scratch(std::env::temp_dir().join(format!("tombolo-digest-{}.json", std::process::id())));
    let output = Command::new(env!("CARGO_BIN_EXE_tombolo-lab"))
        .args(["digest", "--json"])
        .arg(&file.0)
        .output()
        .unwrap();
    let (table, errors) = (String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr));
    assert!(output.status.success(), "{table}\n{errors}");
    let json: serde_json::Value = serde_json::from_slice(&std::fs::read(&file.0).unwrap()).unwrap();

    assert_eq!(json["equal"], true);
    assert_eq!(json["expected"], lab::digest::EXPECTED);
    for backend in json["backends"].as_array().unwrap() {
        assert!(backend["state"] == "equal" || backend["state"] == "skipped", "{backend}");
        assert_eq!(backend["state"] == "skipped", backend["digest"].is_null(), "{backend}");
        assert_ne!(backend["detail"], "", "{backend}");
        if backend["state"] == "skipped" {
            eprintln!("SKIPPED: {}: {}", backend["name"], backend["detail"]);
        }
    }
    let control = &json["control"];
    assert_eq!(control["differs"], true, "{control}");
    assert_ne!(control["digest"], json["expected"], "{control}");
}

#[test]
fn an_unwritable_result_file_is_an_error_before_measuring() {
    let output = Command::new(env!("CARGO_BIN_EXE_tombolo-lab"))
        .args(["digest", "--json", "/no/such/folder/a.json"])
        .output()
        .unwrap();
    let errors = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(2), "{errors}");
    assert!(errors.starts_with("tombolo-lab: --json: ") && errors.lines().count() == 1, "{errors}");
}
