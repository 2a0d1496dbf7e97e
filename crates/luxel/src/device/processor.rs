//! The name of the processor, where the system tells it without privileges.

/// Returns the name of the processor.
pub fn processor_name() -> Option<String> {
    name_in(&std::fs::read_to_string("/proc/cpuinfo").unwrap_or_default())
}

/// Returns the name in a text as of `/proc/cpuinfo`.
fn name_in(cpuinfo: &str) -> Option<String> {
    let value =
        |key: &str| cpuinfo.lines().find_map(|line| line.strip_prefix(key)?.trim_start().strip_prefix(':')).map(|v| v.trim().to_owned());
    value("model name").or_else(|| value("Model")).filter(|name| !name.is_empty())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_name_is_read_where_the_system_tells_it() {
        assert_eq!(name_in("processor\t: 0\nmodel name\t: Fast CPU @ 2 GHz\n"), Some("Fast CPU @ 2 GHz".into()));
        assert_eq!((name_in(""), name_in("model name\t:\n")), (None, None));
    }
}
