//! Facts about this machine that need no privileges to read.

/// Returns names and values for people.
pub fn facts(cores: usize) -> Vec<(&'static str, String)> {
    let mut facts = Vec::new();
    if let Some(model) = processor() {
        facts.push(("processor", model));
    }
    facts.push(("cores", format!("{cores} for this program")));
    if let Some(bytes) = memory_bytes(&read("/proc/meminfo")) {
        facts.push(("memory", crate::text::bytes(bytes)));
    }
    facts.push(("system", format!("{} on {}", std::env::consts::OS, std::env::consts::ARCH)));
    facts
}

/// Returns the name of the processor.
pub fn processor() -> Option<String> {
    processor_of(&read("/proc/cpuinfo"))
}

/// Returns the text of a file of the system; empty where there is none.
fn read(path: &str) -> String {
    std::fs::read_to_string(path).unwrap_or_default()
}

fn processor_of(cpuinfo: &str) -> Option<String> {
    let value =
        |key: &str| cpuinfo.lines().find_map(|line| line.strip_prefix(key)?.trim_start().strip_prefix(':')).map(|v| v.trim().to_owned());
    value("model name").or_else(|| value("Model")).filter(|name| !name.is_empty())
}

fn memory_bytes(meminfo: &str) -> Option<u64> {
    let rest = meminfo.lines().find_map(|line| line.strip_prefix("MemTotal:"))?;
    rest.trim().strip_suffix("kB")?.trim().parse::<u64>().ok()?.checked_mul(1024)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn facts_are_read_where_the_system_tells_them() {
        assert_eq!(processor_of("processor\t: 0\nmodel name\t: Fast CPU @ 2 GHz\n"), Some("Fast CPU @ 2 GHz".into()));
        assert_eq!((processor_of(""), processor_of("model name\t:\n")), (None, None));
        assert_eq!((memory_bytes("MemTotal:   16 kB\n"), memory_bytes("MemFree: 3 kB\n")), (Some(16384), None));
        assert!(facts(3).iter().any(|(name, value)| *name == "cores" && value.starts_with('3')));
    }
}
