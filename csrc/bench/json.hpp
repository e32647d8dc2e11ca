// Just enough of JSON to write a benchmark's result.
#pragma once
#include <cmath>
#include <cstdio>
#include <string>
#include <vector>

namespace tledface::bench {

class Json {
 public:
  Json& add(const std::string& key, double value) { return put(key, number(value)); }
  Json& add(const std::string& key, std::size_t value) { return put(key, std::to_string(value)); }
  Json& add(const std::string& key, int value) { return put(key, std::to_string(value)); }
  Json& add(const std::string& key, bool value) { return put(key, value ? "true" : "false"); }
  Json& add(const std::string& key, const char* value) { return put(key, quoted(value)); }
  Json& add(const std::string& key, const std::string& value) { return put(key, quoted(value)); }
  Json& add(const std::string& key, const Json& value) { return put(key, value.text()); }
  Json& add(const std::string& key, const std::vector<double>& values) {
    std::string list;
    for (const double value : values) list += (list.empty() ? "" : ", ") + number(value);
    return put(key, "[" + list + "]");
  }
  Json& add_null(const std::string& key) { return put(key, "null"); }
  std::string text() const { return "{" + body_ + "}"; }

 private:
  Json& put(const std::string& key, const std::string& value) {
    body_ += (body_.empty() ? "" : ", ") + quoted(key) + ": " + value;
    return *this;
  }
  static std::string number(double value) {
    if (!std::isfinite(value)) return "null";
    char text[32];
    std::snprintf(text, sizeof text, "%.6g", value);
    return text;
  }
  static std::string quoted(const std::string& value) {
    std::string text = "\"";
    for (const char c : value) {
      if (c == '"' || c == '\\') text += '\\';
      text += static_cast<unsigned char>(c) < ' ' ? ' ' : c;
    }
    return text + "\"";
  }
  std::string body_;
};

}  // namespace tledface::bench
