//! Completions and man pages, which packages install.

use assert_cmd::Command;

const COMMANDS: [&str; 4] = ["train", "render", "edit", "completions"];

#[test]
fn each_shell_gets_a_script_that_names_the_commands() {
    for shell in ["bash", "zsh", "fish", "powershell", "elvish"] {
        let output = Command::cargo_bin("luxel").unwrap().args(["completions", shell]).output().unwrap();
        assert!(output.status.success(), "{shell}");
        let script = String::from_utf8(output.stdout).unwrap();
        for command in COMMANDS {
            assert!(script.contains(command), "{shell}: {command}");
        }
        assert!(script.contains("max-splats"), "{shell}: no options");
    }
}

#[test]
fn each_command_has_a_man_page() {
    let folder = tempfile::tempdir().unwrap();
    let pages = folder.path().join("share/man1");
    Command::cargo_bin("luxel").unwrap().arg("man").arg(&pages).assert().success();
    assert!(std::fs::read_to_string(pages.join("luxel.1")).unwrap().contains("luxel\\-train(1)"));
    for command in COMMANDS {
        let page = std::fs::read_to_string(pages.join(format!("luxel-{command}.1"))).unwrap();
        assert!(page.contains(".SH SYNOPSIS") && page.contains(".SH DESCRIPTION"), "{command}");
    }
}

#[test]
fn a_folder_that_cannot_be_made_is_named() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("file"), "").unwrap();
    let output = Command::cargo_bin("luxel").unwrap().arg("man").arg(folder.path().join("file/man")).output().unwrap();
    assert!(!output.status.success());
    assert!(String::from_utf8(output.stderr).unwrap().contains("file/man: cannot create the folder"));
}
