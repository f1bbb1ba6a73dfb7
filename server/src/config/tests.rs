//! Defaults, precedence and errors of options.

use super::*;
use clap::{CommandFactory, Parser};
use std::path::PathBuf;

fn with_file(content: &str, args: Args) -> Result<ServerConfig, UsageError> {
    let name = format!("tombolo-config-{}-{:?}.toml", std::process::id(), std::thread::current().id());
    let path = std::env::temp_dir().join(name);
    std::fs::write(&path, content).unwrap();
    let result = Args { config: Some(path.clone()), ..args }.resolve();
    std::fs::remove_file(path).unwrap();
    result
}

#[test]
fn the_defaults_are_the_documented_ones() {
    let config = Args::default().resolve().unwrap();
    assert_eq!(config.listen.to_string(), DEFAULT_LISTEN);
    assert_eq!((config.world_seed, config.max_sessions), (1, 1024));
    // On this machine; `memory` tests it for any memory.
    assert_eq!(config.cache_bytes, memory::default_cache_mb(MemoryLimit::of_process().as_ref()) << 20);
    assert_eq!(config.disk, None);
}

#[test]
fn a_flag_overrides_the_file_and_the_file_the_default() {
    let file = "world-seed = 7\ncache-mb = 64\nlog-json = true\n";
    let config = with_file(
        file,
        Args { options: Options { world_seed: Some(9), ..Options::default() }, ..Args::default() },
    )
    .unwrap();
    assert_eq!((config.world_seed, config.cache_bytes, config.log_json), (9, 64 << 20, true));
}

/// Every option with a value: one of a file, and another one of the command line. Lists are the
/// last.
const OPTIONS: [(&str, &str, &str); 20] = [
    ("listen", "\"127.0.0.1:1\"", "127.0.0.1:2"),
    ("world-seed", "5", "6"),
    ("threads", "5", "6"),
    ("cache-mb", "5", "6"),
    ("disk-cache", "\"/x/5\"", "/x/6"),
    ("disk-mb", "65", "66"),
    ("store", "\"s3://x/5\"", "s3://x/6"),
    ("store-wait-ms", "5", "6"),
    ("proxy-header", "\"forwarded\"", "proxy-protocol"),
    ("max-sessions", "5", "6"),
    ("max-sessions-per-address", "5", "6"),
    ("rate-limit-ms", "5", "6"),
    ("deadline-ms", "15", "16"),
    ("otlp", "\"http://a/5\"", "http://a/6"),
    ("trace-every", "5", "6"),
    ("log", "\"warn\"", "error"),
    ("trusted-proxy", "[\"10.0.0.5\"]", "10.0.0.6"),
    ("allowed-host", "[\"a5\"]", "a6"),
    ("allowed-origin", "[\"https://a5\"]", "https://a6"),
    ("token-file", "\"/x/5\"", "/x/6"),
];

/// Options without which another one is an error.
fn needs(option: &str) -> &'static str {
    match option {
        "disk-mb" => "disk-cache = \"/x/0\"\n",
        "store-wait-ms" => "store = \"s3://x/0\"\n",
        "proxy-header" => "trusted-proxy = [\"10.0.0.1\"]\n",
        "trace-every" => "otlp = \"http://a/0\"\n",
        _ => "",
    }
}

#[test]
fn each_option_of_the_command_line_wins_over_the_file_and_the_file_over_the_default() {
    for (option, in_file, given) in OPTIONS {
        let others = needs(option);
        let resolve = |file: &str, arguments: &[String]| {
            let mut all = vec!["tombolo-server".to_owned()];
            all.extend_from_slice(arguments);
            let file = parse_file(&format!("{others}{file}"), "test").unwrap();
            // A file of tokens is read: the error names it.
            match Args::try_parse_from(all).unwrap().resolve_over(file) {
                Ok(config) => format!("{config:?}"),
                Err(error) => error.to_string(),
            }
        };
        let line = format!("{option} = {in_file}");
        let argument = [format!("--{option}={given}")];
        let (default, of_file) = (resolve("", &[]), resolve(&line, &[]));
        let (of_both, of_argument) = (resolve(&line, &argument), resolve("", &argument));
        assert_eq!(of_both, of_argument, "{option}");
        assert!(default != of_file && of_file != of_both && default != of_both, "{option}: {default}");
    }
    // No option is left out but pairs of files, flags, and what only counts together with others.
    let command = Args::command();
    let names = command.get_arguments().filter(|option| !option.is_hide_set()).filter_map(|o| o.get_long());
    let tested = OPTIONS.map(|(option, ..)| option);
    let rest: Vec<_> = names.filter(|name| !tested.contains(name)).collect();
    assert_eq!(rest, ["insecure", "tls-cert", "tls-key", "protect", "log-json", "config"]);
}

#[test]
fn a_switch_can_be_turned_off_over_the_file() {
    let file = "insecure = true\nlisten = \"0.0.0.0:0\"\nlog-json = true\n";
    let given = |arguments: &[&str]| {
        let arguments = std::iter::once("tombolo-server").chain(arguments.iter().copied());
        Args::try_parse_from(arguments).unwrap()
    };
    assert!(with_file(file, given(&[])).unwrap().log_json);
    assert!(!with_file(file, given(&["--log-json=false"])).unwrap().log_json);
    assert!(with_file(file, given(&["--insecure=false"])).is_err());
    for switch in ["--log-json", "--log-json=true"] {
        assert!(with_file("log-json = false", given(&[switch])).unwrap().log_json, "{switch}");
    }
}

#[test]
fn lists_may_have_blanks_and_empty_parts() {
    let arguments = ["tombolo-server", "--trusted-proxy", "10.0.0.1, 10.0.0.2", "--allowed-host", "a,"];
    let config = Args::try_parse_from(arguments).unwrap().resolve().unwrap();
    assert!(config.proxies.contains("10.0.0.2".parse().unwrap()));
    assert_eq!(config.allowed_hosts, AllowedHosts::parse(&["a".to_owned()]).unwrap());
}

#[test]
fn a_disk_cache_has_a_default_size() {
    let config = with_file("disk-cache = \"/var/cache/x\"\n", Args::default()).unwrap();
    assert_eq!(config.disk, Some(DiskConfig { folder: "/var/cache/x".into(), bytes: 1 << 30 }));
}

#[test]
fn the_former_name_of_the_rate_limit_is_accepted() {
    let parsed = Args::try_parse_from(["tombolo-server", "--cost-per-second", "50"]).unwrap();
    assert_eq!(parsed.resolve().unwrap().rate_limit_ms, Some(50));
    let parsed = Args::try_parse_from(["tombolo-server", "--rate-limit-ms", "60"]).unwrap();
    assert_eq!(parsed.resolve().unwrap().rate_limit_ms, Some(60));
    assert_eq!(with_file("cost-per-second = 70", Args::default()).unwrap().rate_limit_ms, Some(70));
}

#[test]
fn a_store_without_the_settings_of_its_engine_is_an_error_of_the_start() {
    let folder = std::env::temp_dir();
    let file = format!("store = '{}'", folder.display());
    assert!(with_file(&file, Args::default()).unwrap().store.is_some());
    let file = format!("store = '{}'", folder.join("tombolo-no-such-folder").display());
    let error = with_file(&file, Args::default()).unwrap_err().to_string();
    assert!(error.starts_with("store: the folder ") && error.contains("create it"), "{error}");
    // Neither the address nor, in tests, the environment names an account.
    let error = with_file("store = \"az://container/chunks\"", Args::default()).unwrap_err().to_string();
    assert!(error.starts_with("store: ") && error.lines().count() == 1, "{error}");
}

#[test]
fn traces_have_an_address_and_a_share() {
    let of = |file: &str| with_file(file, Args::default()).unwrap().traces;
    let traces = of("otlp = \"http://a:4318/v1/traces\"").unwrap();
    assert_eq!((traces.endpoint.as_str(), traces.every), ("http://a:4318/v1/traces", 1000));
    assert_eq!(of("otlp = \"https://a/b\"\ntrace-every = 0").unwrap().every, 0);
    assert_eq!(of("otlp = \"http://a:4318\"").unwrap().endpoint.path(), "/v1/traces");
    assert_eq!((of(""), of("otlp = \"\"")), (None, None));
    let mut given = Args::default();
    given.options.otlp = Some(String::new());
    let traces = with_file("otlp = \"http://a\"\ntrace-every = 7", given).unwrap().traces.unwrap();
    assert_eq!((traces.endpoint.host_str(), traces.every), (Some("a"), 7), "an empty variable");
}

#[test]
fn empty_text_is_no_option_unless_it_protects_the_server() {
    let mut given = Args::default();
    let options = &mut given.options;
    (options.store, options.log) = (Some(String::new()), Some(String::new()));
    options.disk_cache = Some(PathBuf::new());
    let config = with_file("log = \"warn\"", given).unwrap();
    assert!(config.store.is_none() && config.disk.is_none());
    assert_eq!(config.log, "warn");
    let mut given = Args::default();
    given.options.token_file = Some(PathBuf::new());
    assert!(with_file("", given).is_err());
}

/// A user cannot turn off a mechanism by accident.
#[test]
fn a_mechanism_is_turned_off_by_a_hidden_option_alone() {
    let parsed = Args::try_parse_from(["tombolo-server", "--measure-without", "turns"]).unwrap();
    assert_eq!(parsed.resolve().unwrap().without, Some(Mechanism::Turns));
    assert_eq!(Args::default().resolve().unwrap().without, None);
    assert!(Args::try_parse_from(["tombolo-server", "--measure-without", "everything"]).is_err());
    assert!(with_file("measure-without = \"turns\"", Args::default()).is_err());
    let mut command = Args::command();
    let option = command.get_arguments().find(|option| option.get_id() == "measure_without").unwrap();
    assert!(option.get_env().is_none());
    assert!(!command.render_long_help().to_string().contains("measure-without"));
}

#[test]
fn errors_are_one_line_with_option_value_and_range() {
    for (file, words) in [
        ("cahce-mb = 1", &["line 1", "cahce-mb", "cache-mb"][..]),
        ("\nthreads = \"two\"", &["line 2", "usize"][..]),
        ("threads = 0", &["threads", "0", "1 to 1024"][..]),
        ("cache-mb = 70000", &["cache-mb", "70000", "65536"][..]),
        ("disk-cache = \"/tmp/x\"\ndisk-mb = 63", &["disk-mb", "63", "64 to 262144"][..]),
        ("disk-mb = 64", &["disk-mb", "64", "disk-cache"][..]),
        ("rate-limit-ms = 0", &["rate-limit-ms", "0", "1 to 1000000"][..]),
        ("cost-per-second = 0", &["rate-limit-ms", "0", "1 to 1000000"][..]),
        ("deadline-ms = 9", &["deadline-ms", "9", "10 to 60000"][..]),
        ("max-sessions-per-address = 0", &["max-sessions-per-address", "0", "1 to 100000"][..]),
        (
            "listen = \"0.0.0.0:7580\"",
            &["listen", "0.0.0.0:7580", "tls-cert", "trusted-proxy", "insecure"][..],
        ),
        ("listen = \"[::]:7580\"", &["listen", "[::]:7580", "insecure"][..]),
        ("listen = \"192.168.1.1:7580\"\ninsecure = false", &["listen", "192.168.1.1:7580", "insecure"][..]),
        ("trusted-proxy = [\"10.0.0.0/99\"]", &["trusted-proxy", "10.0.0.0/99"][..]),
        ("proxy-header = \"forwarded\"", &["proxy-header", "forwarded", "trusted-proxy"][..]),
        ("allowed-host = [\"a:1\"]", &["allowed-host", "a:1"][..]),
        ("allowed-origin = [\"a\"]", &["allowed-origin", "`a`"][..]),
        ("protect = [\"metrics\"]", &["protect", "metrics", "token-file"][..]),
        ("tls-cert = \"/x\"", &["tls-cert", "tls-key"][..]),
        ("trace-every = 10", &["trace-every", "otlp"][..]),
        ("otlp = \"http://a\"\ntrace-every = 1000000001", &["trace-every", "0 to 1000000000"][..]),
        ("otlp = \"grpc://a:4317\"", &["otlp", "http://HOST:4318/v1/traces"][..]),
        ("otlp = \"http://me:secret@a\"", &["otlp", "OTEL_EXPORTER_OTLP_HEADERS"][..]),
        ("otlp = \"collector\"", &["otlp", "http://HOST:4318/v1/traces"][..]),
        ("log = \"loud\"", &["log", "loud", "info", "trace"][..]),
        ("log = \"info,server\"", &["log", "`server`", "info,server=debug"][..]),
        ("log = \"server=loud\"", &["log", "server=loud"][..]),
        ("listen = \"nowhere\"", &["listen", "nowhere", "ADDR:PORT"][..]),
        ("token-file = \"/does/not/exist\"", &["token-file", "/does/not/exist"][..]),
        ("= broken", &["line 1"][..]),
    ] {
        let message = with_file(file, Args::default()).unwrap_err().to_string();
        assert!(!message.contains('\n'), "{message}");
        for word in words {
            assert!(message.contains(word), "`{message}` lacks `{word}`");
        }
    }
    let missing = Args { config: Some("/does/not/exist.toml".into()), ..Args::default() };
    assert!(missing.resolve().unwrap_err().to_string().contains("/does/not/exist.toml"));
}

#[test]
fn plain_text_beyond_the_loopback_needs_an_option_and_the_loopback_none() {
    for (file, is_allowed) in [
        ("listen = \"127.0.0.1:0\"", true),
        ("listen = \"127.3.2.1:0\"", true),
        ("listen = \"[::1]:0\"", true),
        ("listen = \"[::ffff:127.0.0.1]:0\"", true),
        ("listen = \"0.0.0.0:0\"", false),
        ("listen = \"0.0.0.0:0\"\ninsecure = true", true),
        ("listen = \"0.0.0.0:0\"\ntrusted-proxy = [\"10.0.0.0/8\"]", true),
    ] {
        assert_eq!(with_file(file, Args::default()).is_ok(), is_allowed, "{file}");
    }
}

#[test]
fn a_negative_number_is_the_value_of_its_option() {
    for (option, value, word) in [
        ("--world-seed", "-1", "0 to 18446744073709551615"),
        ("--world-seed", "18446744073709551616", "0 to 18446744073709551615"),
        ("--threads", "-1", "-1"),
    ] {
        let error = Args::try_parse_from(["tombolo-server", option, value]).unwrap_err().to_string();
        assert!(error.contains(option) && error.contains(value) && error.contains(word), "{error}");
    }
}

#[test]
fn filters_of_log_lines_are_levels_and_levels_of_modules() {
    for filter in ["info", "off", "ERROR", "warn,server=debug", "server::http=trace,info"] {
        assert!(log_filter(filter).is_ok(), "{filter}");
    }
}

#[test]
fn lists_are_repeated_options_or_parts_of_one_value() {
    let arguments = [
        "tombolo-server",
        "--trusted-proxy",
        "10.0.0.1,10.0.0.2",
        "--trusted-proxy",
        "::1",
        "--allowed-host",
        "a",
    ];
    let config = Args::try_parse_from(arguments).unwrap().resolve().unwrap();
    for address in ["10.0.0.1", "10.0.0.2", "::1"] {
        assert!(config.proxies.contains(address.parse().unwrap()), "{address}");
    }
    assert!(!config.proxies.contains("10.0.0.3".parse().unwrap()));
    assert_eq!(config.allowed_hosts, AllowedHosts::parse(&["a".to_owned()]).unwrap());
}
