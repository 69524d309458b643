import js from "@eslint/js";
export default [{ ...js.configs.recommended, languageOptions: { sourceType: "script" }, rules: {
  ...js.configs.recommended.rules, "no-undef": "off", "no-var": "error",
  "prefer-const": ["error", { destructuring: "all" }],
  eqeqeq: ["error", "always", { null: "ignore" }],
  "no-unused-vars": ["error", { vars: "local", argsIgnorePattern: "^_", varsIgnorePattern: "^_" }],
} }];
